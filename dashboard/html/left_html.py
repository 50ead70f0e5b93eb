"""What exploration has left, as HTML. Every string from the wire is escaped."""

from robrain.dashboard.html.html_words import text
from robrain.dashboard.state.team_view import TeamView
from robrain.protocol.messages.maps.left_messages import RegionLeft

ROWS = 20


def left_html(view: TeamView) -> str:
    """The regions that exploration has left, with reasons, largest first; empty before it has ended."""
    left = view.left
    if left is None:
        return ""
    if not left.regions:
        return '<div class="rb"><div class="rb-none" data-testid="left-none">Nothing is left to explore.</div></div>'
    head = (
        '<tr><th style="width: 34%">Region</th><th class="rb-number" style="width: 33%">At x, y (m)</th>'
        '<th class="rb-number" style="width: 33%">Area</th></tr>'
    )
    rows = "".join(_rows(number, region) for number, region in enumerate(left.regions[:ROWS], 1))
    hidden = left.regions[ROWS:]
    more, more_m2 = len(hidden) + left.more, sum(region.area_m2 for region in hidden) + left.more_m2
    rest = f'<div class="rb-none" data-testid="left-more">and {more} more, {more_m2:.1f} m²</div>' if more else ""
    return f'<div class="rb"><table data-testid="left">{head}{rows}</table>{rest}</div>'


def _rows(number: int, region: RegionLeft) -> str:
    place, kind = region.place, region.kind.value.replace("_", " ")
    return (
        f'<tr class="rb-top"><td><b data-testid="left-{number}-kind">{kind}</b></td>'
        f'<td class="rb-number" data-testid="left-{number}-place">{place.x_m:.1f}, {place.y_m:.1f}</td>'
        f'<td class="rb-number" data-testid="left-{number}-area">{region.area_m2:.1f} m²</td></tr>'
        f'<tr class="rb-why"><td colspan="3" data-testid="left-{number}-why">{text(region.words, 200)}</td></tr>'
    )
