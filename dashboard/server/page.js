"use strict";
(() => {
  // -- rows and buttons inside of HTML: their data-rb is sent as the value of a hidden text field -----------------
  let sent = 0;
  function send(what) {
    const marks = document.querySelectorAll(".rb-channel");
    for (const mark of marks) {
      const field = mark.parentElement?.nextElementSibling?.querySelector("input");
      if (!field) continue;
      // React listens to what the prototype's setter does, not to what is assigned to the element.
      const setter = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
      setter.call(field, `${++sent} ${what}`);
      field.dispatchEvent(new Event("input", { bubbles: true }));
      return;
    }
  }
  // Tables are drawn anew while a button is held down, and the browser then knows of no click: a press and a release
  // on what means the same are one.
  function meant(event) {
    const target = event.target instanceof Element ? event.target.closest(".rb [data-rb]") : null;
    return target ? target.getAttribute("data-rb") : null;
  }
  let pressed = null;
  document.addEventListener("pointerdown", (event) => {
    const what = event.button === 0 && event.isPrimary ? meant(event) : null;
    pressed = what ? { what, x: event.clientX, y: event.clientY } : null;
  }, true);
  document.addEventListener("pointerup", (event) => {
    const began = pressed;
    pressed = null;
    const far = began && Math.hypot(event.clientX - began.x, event.clientY - began.y) > 10;
    if (began && !far && meant(event) === began.what) send(began.what);
  }, true);
  document.addEventListener("keydown", (event) => {
    const target = event.target instanceof Element ? event.target.closest(".rb [data-rb]") : null;
    if (target && (event.key === "Enter" || event.key === " ")) {
      send(target.getAttribute("data-rb"));
      event.preventDefault();
    }
  });

  // -- keys mean the page also when a box was ticked last; viser leaves them to whatever has the focus -------------
  function again(key) {
    const event = new KeyboardEvent("keydown", { key, code: `Key${key.toUpperCase()}`, bubbles: true, cancelable: true });
    document.documentElement.dispatchEvent(event);
  }
  const WRITTEN = "input:not([type=checkbox], [type=radio], [type=range], [type=button], [readonly]), "
    + "textarea, select, [contenteditable]";
  let left = null;
  // A field that is hidden or was left with Escape, like that of a closed palette, may keep the focus for a moment.
  function isTyping(event) {
    const field = event.target instanceof Element ? event.target.closest(WRITTEN) : null;
    return field !== null && field !== left && field.checkVisibility();
  }

  // -- the halt: its key works outside text fields, its button lies above everything ----------------------------------
  const halt = () => again("h");
  addEventListener("keydown", (event) => {
    if (!event.isTrusted || event.key.toLowerCase() !== "h") return;  // synthetic events from `again` go to viser
    if (event.ctrlKey || event.metaKey || event.altKey || isTyping(event)) return;
    event.stopImmediatePropagation();
    event.preventDefault();
    if (!event.repeat) halt();
  }, true);

  // -- Escape closes the topmost window, or leaves a field -------------------------------------------------------------
  addEventListener("focusin", () => { left = null; }, true);
  addEventListener("keydown", (event) => {
    const palette = document.querySelector(".mantine-Spotlight-content");
    if (event.key !== "Escape" && !(event.key === "Enter" && palette)) return;
    if (!palette) {
      const mark = [...document.querySelectorAll(".mantine-Modal-content .rb-close-mark")].pop();
      const button = mark?.parentElement?.nextElementSibling?.querySelector("button");
      if (button) {
        button.click();
        return;
      }
    }
    // Mantine closes the palette itself, but keeps the focus in its field until the palette has faded out.
    const field = document.activeElement;
    if (field instanceof HTMLElement && field !== document.body && field.closest("input, textarea")) {
      left = field;
      setTimeout(() => { if (document.activeElement === field && left === field) field.blur(); });
    }
  }, true);
  document.addEventListener("keydown", (event) => {
    const target = event.target;
    const isBox = target instanceof HTMLInputElement && (target.type === "checkbox" || target.readOnly);
    if (isBox && /^[a-z]$/i.test(event.key) && !event.ctrlKey && !event.metaKey && !event.altKey) {
      target.blur();
      again(event.key);
    }
  });

  // -- teleoperation: a held key presses the button that says the same -----------------------------------------------
  const WORDS = { w: "Forward", s: "Back", a: "Turn left", d: "Turn right", q: "Left", e: "Right" };
  const held = new Map();
  function press(word) {
    if (!document.querySelector(".rb-teleop-armed")) return null;
    for (const button of document.querySelectorAll("button")) {
      if (button.textContent.replace(/\s*\([A-Z]\)$/, "") === word) return button;
    }
    return null;
  }
  function pointer(button, kind) {
    button.dispatchEvent(new PointerEvent(kind, { bubbles: true, button: 0, pointerId: 1, isPrimary: true }));
  }
  addEventListener("keydown", (event) => {
    const word = WORDS[event.key.toLowerCase()];
    if (!word || event.ctrlKey || event.metaKey || event.altKey || isTyping(event)) return;
    const button = press(word);
    if (!button) return;
    event.stopImmediatePropagation();  // viser moves the camera with these keys
    if (held.has(word)) return;
    held.set(word, button);
    pointer(button, "pointerdown");
  }, true);
  function release(word) {
    const button = held.get(word);
    held.delete(word);
    if (button) pointer(button, "pointerup");
  }
  addEventListener("keyup", (event) => release(WORDS[event.key.toLowerCase()]), true);
  for (const gone of ["blur", "pagehide"]) addEventListener(gone, () => [...held.keys()].forEach(release));

  addEventListener("DOMContentLoaded", () => {
    if (document.querySelector("meta[name=rb-halt]")) {  // a recording has none
      const button = document.createElement("button");
      button.id = "rb-halt";
      button.type = "button";
      button.textContent = "EMERGENCY HALT";
      button.title = "Halt all robots at once. Key: H";
      // The press counts, not the release: the hand may slip off the button.
      button.addEventListener("pointerdown", (event) => { if (event.button === 0) { event.preventDefault(); halt(); } });
      button.addEventListener("click", (event) => { if (event.detail === 0) halt(); });  // Enter, space, assistive tools
      for (const kind of ["mousedown", "touchstart", "keydown"]) {
        button.addEventListener(kind, (event) => event.stopPropagation());  // keeps an open window open
      }
      document.body.append(button);
    }
    const lost = document.createElement("div");
    lost.id = "rb-lost";
    lost.textContent = "No word from the dashboard: what is shown is old. To halt, use the robots' own buttons.";
    document.body.append(lost);
    let beat = "", since = performance.now();
    setInterval(() => {
      const now = document.querySelector("[data-rb-beat]")?.getAttribute("data-rb-beat") ?? "";
      if (now === "" || now !== beat || document.hidden) since = performance.now();
      beat = now;
      // When a demo ends, its page shows the recording, which has nothing to halt.
      const button = document.getElementById("rb-halt");
      if (button) button.style.display = document.querySelector("[data-testid=replay-time]") ? "none" : "";
      lost.style.display = performance.now() - since > 6000 ? "block" : "none";
    }, 500);
  });
})();
