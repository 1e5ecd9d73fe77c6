"""The style sheet of a trial's page: that of all bag reports, extended by a dark mode and a layout for phones."""

from __future__ import annotations

from gibson_sim.bags.plots.style import PAGE_STYLE

STYLE = (
    PAGE_STYLE
    + """
:root {
  color-scheme: light dark;
  --ink: #111827; --quiet: #4b5563; --line: #e5e7eb; --head: #9ca3af; --page: #fff; --box: #f3f4f6;
  --good: #1d4ed8; --bad: #c2410c; --bar: #bfdbfe;
}
@media (prefers-color-scheme: dark) {
  :root {
    --ink: #e5e7eb; --quiet: #9ca3af; --line: #374151; --head: #6b7280; --page: #0f172a; --box: #1e293b;
    --good: #60a5fa; --bad: #fb923c; --bar: #1e3a8a;
  }
}
body { max-width: 1120px; color: var(--ink); background: var(--page); overflow-wrap: anywhere; }
h2, th, td { border-color: var(--line); }
h3 { font-size: 1em; margin: 1.4em 0 .3em; }
th { color: var(--quiet); border-bottom-color: var(--head); }
a { color: var(--good); }
.quiet { color: var(--quiet); }
.good { color: var(--good); } .bad { color: var(--bad); font-weight: 600; }
.total { font-size: 1.25em; margin: .7em 0 .5em; } .total b { font-size: 1.35em; }
.scroll { overflow-x: auto; } .scroll td, .scroll th { overflow-wrap: normal; }
.nowrap { white-space: nowrap; }
.rate { position: relative; display: inline-block; width: 9em; height: .9em; background: var(--box); border-radius: 2px; vertical-align: -.1em; }
.rate i { position: absolute; top: 0; height: 100%; background: var(--bar); border-radius: 2px; }
.rate b { position: absolute; top: -.1em; height: 1.1em; width: 3px; margin-left: -1.5px; background: var(--good); }
.total .rate { display: block; width: 100%; max-width: 34em; height: .7em; margin-top: .5em; }
.maps { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 480px), 1fr)); gap: 0 1.5em; }
.maps > div { max-width: 820px; }
.map { display: block; max-height: 85vh; margin: .4em 0 1em; border: 1px solid var(--line); }
.map image { image-rendering: pixelated; }
.map polyline, .map path, .map rect { fill: none; stroke-width: 1.6px; vector-effect: non-scaling-stroke; stroke-linejoin: round; }
.map circle { vector-effect: non-scaling-stroke; stroke-width: 1.4px; }
.map .passed { stroke: var(--good); } .map .passed polyline { opacity: .55; }
.map .failed { stroke: var(--bad); } .map .failed polyline { stroke-dasharray: 6 4; stroke-width: 2.2px; }
.map .failed path.end { stroke-width: 3px; } .map .goal { stroke-dasharray: 2 2; }
.map .start { fill: var(--page); } .map .passed .end { fill: var(--good); }
.map text {
  fill: var(--bad); font: 600 calc(var(--unit) * 2.6px) system-ui, sans-serif;
  paint-order: stroke; stroke: var(--page); stroke-width: calc(var(--unit) * .6px);
}
.map a:hover polyline { stroke-width: 4px; }
details.run { border: 1px solid var(--line); border-left: 4px solid var(--bad); border-radius: 4px; margin: .8em 0; padding: .5em .9em; }
details.run > summary { cursor: pointer; } details.run > summary b { margin-right: .5em; }
ul.verdicts { list-style: none; padding: 0; margin: .5em 0; } ul.verdicts li { padding-left: 1.5em; text-indent: -1.5em; }
ul.verdicts li::before { content: "✓"; display: inline-block; width: 1.5em; text-indent: 0; color: var(--good); }
ul.verdicts li.no::before { content: "✗"; color: var(--bad); font-weight: 700; } ul.verdicts li.no { font-weight: 600; }
figure { margin: .8em 0; } figure img { display: block; max-width: 100%; height: auto; background: #fff; border-radius: 3px; }
figcaption { color: var(--quiet); font-size: .9em; }
.pictures { display: flex; flex-wrap: wrap; gap: 0 1em; align-items: flex-start; }
.pictures figure { flex: 1 1 320px; min-width: 0; } .pictures figure.wide { flex-basis: 100%; }
pre {
  background: var(--box); padding: .6em .8em; margin: .3em 0 .8em; overflow-x: auto; border-radius: 4px;
  font: .82em/1.45 ui-monospace, Menlo, Consolas, monospace;
}
pre.log { max-height: 20em; overflow-y: auto; white-space: pre-wrap; overflow-wrap: anywhere; display: flex; flex-direction: column-reverse; }
pre.command { white-space: pre-wrap; user-select: all; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .15em 1em; margin: .4em 0; } dt { color: var(--quiet); } dd { margin: 0; }
@media (max-width: 600px) {
  body { margin: 1em auto; padding: 0 .8em; }
  th, td { padding: .25em .45em; } .rate { width: 5em; }
  .map text { font-size: calc(var(--unit) * 4.2px); }
  details.run { padding: .4em .6em; } dl { grid-template-columns: 1fr; } dd { margin-bottom: .3em; }
}
@media print { details.run { break-inside: avoid; } pre.log { max-height: none; } }
"""
)
