"""The report of a live chase from its log: one HTML page that holds all it shows and needs no network."""

import base64
from collections.abc import Iterable, Mapping, Sequence
from html import escape

from .recorded_chase import RecordedEvent

STYLE_SHEET = """
:root { color-scheme: light dark; }
body { font: 15px/1.45 system-ui, sans-serif; max-width: 68rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.4rem; } h2 { font-size: 1.1rem; margin-top: 2rem; }
figure { margin: 0; background: white; border-radius: 4px; } img { width: 100%; height: auto; display: block; }
table { border-collapse: collapse; } .wide { overflow-x: auto; }
th, td { text-align: left; vertical-align: top; padding: .2rem .8rem .2rem 0; border-bottom: 1px solid #8884; }
td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.critical { color: #d55e00; font-weight: 600; } .success { color: #009e73; font-weight: 600; }
.warning { color: #b07800; font-weight: 600; }
"""
"""No more than a browser's own fonts."""


def recorded_chase_page(
    title: str,
    picture: bytes,
    facts: Mapping[str, str],
    trackers: Sequence[Mapping[str, str]],
    events: Iterable[RecordedEvent],
    settings: Mapping[str, Mapping[str, str]],
) -> str:
    """The page.

    Args:
        picture: PNG.
        facts: how the chase went.
        trackers: each with the same columns.
        events: in the order of their time.
        settings: what the chase was run with, by heading.
    """
    parts = [
        f"<h1>{escape(title)}</h1>",
        _pairs(facts),
        f'<figure><img alt="{escape(title, quote=True)}" src="data:image/png;base64,'
        f'{base64.b64encode(picture).decode()}"></figure>',
        "<h2>Trackers at the end</h2>",
        _table(trackers),
        "<h2>What happened</h2>",
        _event_table(events),
    ]
    for heading, values in settings.items():
        parts += [f"<h2>{escape(heading)}</h2>", _pairs(values)]
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width">\n<title>{escape(title)}</title>\n'
        f"<style>{STYLE_SHEET}</style>\n</head>\n<body>\n" + "\n".join(parts) + "\n</body>\n</html>\n"
    )


def _pairs(values: Mapping[str, str]) -> str:
    rows = (f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in values.items())
    return f'<div class="wide"><table>{"".join(rows)}</table></div>'


def _table(lines: Sequence[Mapping[str, str]]) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in (lines[0] if lines else {}))
    rows = ("<tr>" + "".join(f"<td>{escape(value)}</td>" for value in line.values()) + "</tr>" for line in lines)
    return f'<div class="wide"><table><tr>{head}</tr>{"".join(rows)}</table></div>'


def _event_table(events: Iterable[RecordedEvent]) -> str:
    rows = (
        f'<tr><td class="number">{event.time_s:.1f} s</td><td class="{escape(event.severity, quote=True)}">'
        f"{escape(event.severity)}</td><td>{escape(event.text)}</td></tr>"
        for event in events
    )
    return f'<div class="wide"><table>{"".join(rows)}</table></div>'
