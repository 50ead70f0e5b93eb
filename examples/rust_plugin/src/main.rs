//! A plugin of a robrain robot, in Rust: the process announces itself as `gauge` and answers two functions.
//!
//! `gauge ROBOT [TEAM]` connects to the endpoint in ROBRAIN_CONNECT. A foreign plugin in any language has these duties:
//!
//! 1. answer `robrain/TEAM/robot/ROBOT/foreign/gauge/info` with its description (a PluginInfo, in JSON),
//! 2. answer `robrain/TEAM/robot/ROBOT/foreign/gauge/call/FUNCTION`, with a result or an error, in JSON,
//! 3. declare the liveliness token `robrain/TEAM/robot/ROBOT/foreign/gauge`, while it runs.
//!
//! The robot's host lists it, checks who may call it, and relays the calls.

use std::time::Instant;

use serde_json::{json, Map, Value};
use zenoh::query::Query;
use zenoh::{Config, Wait};

type Fatal = Box<dyn std::error::Error + Send + Sync>;

/// An error of the wire: its code is one of those in docs/reference/topics.md's errors, its text is for a person.
struct CallError {
    code: &'static str,
    message: String,
}

fn bad_arguments(message: String) -> CallError {
    CallError { code: "bad_arguments", message }
}

fn main() -> Result<(), Fatal> {
    let mut arguments = std::env::args().skip(1);
    let robot = arguments.next().ok_or("usage: gauge ROBOT [TEAM]")?;
    let team = arguments.next().unwrap_or_else(|| "default".to_string());
    let connect = std::env::var("ROBRAIN_CONNECT").map_err(|_| "set ROBRAIN_CONNECT, as to tcp/127.0.0.1:7447")?;

    let session = zenoh::open(config(&connect)?).wait()?;
    let own_key = format!("robrain/{team}/robot/{robot}/foreign/gauge");
    let started = Instant::now();

    let info_key = format!("{own_key}/info");
    let reply_key = info_key.clone();
    let _info = session
        .declare_queryable(&info_key)
        .callback(move |query| reply(&query, &reply_key, Ok(info())))
        .wait()?;
    // Callbacks run on Zenoh's own thread: what takes long must be handed to another.
    let _calls = session
        .declare_queryable(format!("{own_key}/call/*"))
        .callback(move |query| {
            let key = query.key_expr().as_str().to_string();
            reply(&query, &key, answer(&query, &key, started));
        })
        .wait()?;
    // Last: whoever sees the token may call.
    let _token = session.liveliness().declare_token(&own_key).wait()?;

    println!("gauge of {robot} is up");
    loop {
        std::thread::park();
    }
}

/// A client of the team's router, as all processes of a robot are.
fn config(connect: &str) -> Result<Config, Fatal> {
    let endpoints: Vec<&str> = connect.split(',').map(str::trim).collect();
    let mut config = Config::default();
    for (key, value) in [
        ("mode", json!("client")),
        ("connect/endpoints", json!(endpoints)),
        ("scouting/multicast/enabled", json!(false)),
        ("transport/link/tx/lease", json!(2000)),
    ] {
        config.insert_json5(key, &value.to_string())?;
    }
    Ok(config)
}

/// The entry in the host's list: a PluginInfo.
fn info() -> Value {
    json!({
        "name": "gauge",
        "level": "device",
        "state": "active",
        "visibility": ["command", "*"],
        "doc": "A gauge, in Rust.",
        "functions": [
            {
                "name": "read",
                "signature": "() -> float",
                "doc": "What the gauge shows, degrees Celsius.",
                "parameters": {"type": "object", "properties": {}, "additionalProperties": false},
                "returns": {"type": "number"},
            },
            {
                "name": "add",
                "signature": "(a: int, b: int) -> int",
                "doc": "The sum of two numbers.",
                "parameters": {
                    "type": "object",
                    "properties": {"a": {"type": "integer"}, "b": {"type": "integer"}},
                    "required": ["a", "b"],
                    "additionalProperties": false,
                },
                "returns": {"type": "integer"},
            },
        ],
    })
}

/// Execute a call; the function is the last part of the key.
fn answer(query: &Query, key: &str, started: Instant) -> Result<Value, CallError> {
    let function = key.rsplit('/').next().unwrap_or_default();
    let payload = query.payload().map(|bytes| bytes.to_bytes().to_vec()).unwrap_or_default();
    match function {
        "read" => {
            named(&payload, &[])?;
            Ok(json!(20.0 + (started.elapsed().as_secs_f64() / 10.0).sin()))
        }
        "add" => {
            let given = named(&payload, &["a", "b"])?;
            let (a, b) = (integer(&given, "a")?, integer(&given, "b")?);
            let sum = a.checked_add(b).ok_or_else(|| bad_arguments(format!("{a} + {b} is too large")))?;
            Ok(json!(sum))
        }
        "*" => Err(bad_arguments(format!("{key}: ask one concrete key"))),
        _ => Err(CallError {
            code: "unknown_function",
            message: format!("gauge has no function {function}; it has: read, add"),
        }),
    }
}

/// Arguments by name: an array is by position, an object by name already, nothing is none.
fn named(payload: &[u8], names: &[&str]) -> Result<Map<String, Value>, CallError> {
    if payload.is_empty() {
        return Ok(Map::new());
    }
    let given = serde_json::from_slice(payload).map_err(|error| bad_arguments(format!("no JSON: {error}")))?;
    match given {
        Value::Array(values) if values.len() <= names.len() => {
            Ok(names.iter().map(|name| name.to_string()).zip(values).collect())
        }
        Value::Array(values) => {
            Err(bad_arguments(format!("takes {} arguments, got {}", names.len(), values.len())))
        }
        Value::Object(values) => match values.keys().find(|name| !names.contains(&name.as_str())) {
            None => Ok(values),
            Some(unknown) => Err(bad_arguments(format!("no argument {unknown}"))),
        },
        _ => Err(bad_arguments("expected an array or an object of arguments".to_string())),
    }
}

fn integer(given: &Map<String, Value>, name: &str) -> Result<i64, CallError> {
    let value = given.get(name).ok_or_else(|| bad_arguments(format!("argument {name} is missing")))?;
    value.as_i64().ok_or_else(|| bad_arguments(format!("argument {name}: expected an integer, got {value}")))
}

/// Every query is answered; a missing answer means "nobody there".
fn reply(query: &Query, key: &str, result: Result<Value, CallError>) {
    let sent = match result {
        Ok(value) => query.reply(key, value.to_string()).encoding("application/json").wait(),
        Err(CallError { code, message }) => query
            .reply_err(json!({"code": code, "message": message}).to_string())
            .encoding("application/json")
            .wait(),
    };
    if let Err(error) = sent {
        eprintln!("gauge: {key} could not be answered: {error}");
    }
}
