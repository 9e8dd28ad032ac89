"""The look of the page."""

CSS = """
:root { --ink: #22262a; --soft: #5c646c; --line: #d9dde1; --pale: #f5f6f7; --blue: #0072b2; --bad: #b3261e; --good: #1a7f4b; }
* { box-sizing: border-box; }
html { background: #fff; color-scheme: light; }
body { margin: 0 auto; max-width: 1120px; padding: 44px 30px 60px; color: var(--ink);
  font: 15px/1.5 "Helvetica Neue", Helvetica, Arial, "Liberation Sans", sans-serif; }
header { border-bottom: 2px solid var(--ink); padding-bottom: 14px; margin-bottom: 26px; }
header p { margin: 0; color: var(--soft); }
h1 { font-size: 31px; line-height: 1.15; font-weight: 650; letter-spacing: -0.012em; margin: 0 0 5px; }
h2 { font-size: 20px; font-weight: 650; letter-spacing: -0.006em; margin: 50px 0 6px; }
h3 { font-size: 15px; font-weight: 650; margin: 24px 0 6px; }
p { margin: 8px 0; max-width: 78ch; }
p.lead { font-size: 17px; line-height: 1.5; max-width: 74ch; }
nav { font-size: 13.5px; margin-top: 14px; } nav a { margin-right: 18px; }
a { color: var(--blue); text-decoration: none; } a:hover { text-decoration: underline; }
.key { display: grid; grid-template-columns: repeat(3, 1fr); gap: 30px; margin: 26px 0 8px; }
.key div { border-top: 3px solid var(--blue); padding-top: 9px; }
.key strong { display: block; font-size: 27px; line-height: 1.2; font-weight: 600; letter-spacing: -0.01em; white-space: nowrap; }
.key span { display: block; color: var(--soft); font-size: 14px; line-height: 1.42; margin-top: 4px; }
.key .bad { border-color: var(--bad); }
table { border-collapse: collapse; width: 100%; font-size: 13.5px; line-height: 1.4; margin: 12px 0; font-variant-numeric: tabular-nums; }
th { text-align: left; font-weight: 600; color: var(--soft); border-bottom: 1px solid var(--ink); padding: 4px 14px 5px 0; vertical-align: bottom; }
td { border-bottom: 1px solid var(--line); padding: 5px 14px 5px 0; vertical-align: top; }
td.n, th.n { text-align: right; white-space: nowrap; }
td:last-child, th:last-child { padding-right: 0; }
tr.bad td { background: #fdf0ef; }
.ok { color: var(--good); white-space: nowrap; } .fail { color: var(--bad); font-weight: 650; white-space: nowrap; }
.note { border-left: 3px solid #e69f00; background: #fdf8ec; padding: 9px 16px; margin: 14px 0; max-width: none; }
.note.bad { border-color: var(--bad); background: #fdf0ef; }
.soft, figcaption { color: var(--soft); } .small, figcaption { font-size: 13px; }
figure { margin: 14px 0 10px; } figcaption { max-width: 92ch; }
figure svg { display: block; width: 100%; height: auto; }
figure svg text { font-family: "Helvetica Neue", Helvetica, Arial, "Liberation Sans", sans-serif !important; }
.facts { display: grid; grid-template-columns: repeat(4, auto); gap: 3px 30px; justify-content: start; font-size: 14px; margin: 12px 0; }
.facts dt { color: var(--soft); } .facts dd { margin: 0 12px 0 -18px; }
.tree { columns: 2; column-gap: 44px; font-size: 12.5px; line-height: 19px; margin: 12px 0; }
.tree.short { columns: 1; max-width: 640px; }
.tree div { display: flex; break-inside: avoid; white-space: nowrap; height: 19px; }
.tree i { flex: none; width: 13px; border-left: 1px solid #c3c9ce; margin-left: 4px; }
.tree i.tick { position: relative; }
.tree i.tick::after { content: ""; position: absolute; left: 0; top: 9px; width: 9px; border-top: 1px solid #c3c9ce; }
.tree b { font-weight: 550; overflow: hidden; text-overflow: ellipsis; }
.tree u { text-decoration: none; color: var(--soft); margin-left: 8px; overflow: hidden; text-overflow: ellipsis; }
.tree u::before { content: "→ "; } .tree:not(.short) u { display: none; }
.tree em { font-style: normal; color: var(--soft); margin-left: auto; padding-left: 12px; }
.tree .fixed, .tree .fixed em { color: #9aa1a8; } .tree .fixed b { font-weight: 400; }
.dot { flex: none; width: 9px; height: 9px; border-radius: 50%; margin: 5px 7px 0 0; border: 2px solid currentColor; }
p.columns { max-width: none; columns: 2; column-gap: 40px; }
.dot.square { border-radius: 1px; background: #22262a; width: 7px; height: 7px; border: 0; margin: 6px 8px 0 1px; }
.two { display: grid; grid-template-columns: 1fr 400px; gap: 36px; align-items: start; }
.swatch { display: inline-block; width: 10px; height: 10px; margin-right: 7px; border-radius: 50%; }
.swatch.hollow { background: #fff !important; border: 2px solid; border-radius: 1px; }
.strip { width: 190px; height: 14px; display: block; margin-top: 3px; }
code { font: 12.5px/1.4 ui-monospace, "SF Mono", Menlo, Consolas, "Liberation Mono", monospace; background: var(--pale); padding: 1px 4px; overflow-wrap: anywhere; }
footer { margin-top: 50px; border-top: 1px solid var(--line); padding-top: 10px; color: var(--soft); font-size: 13px; }
@media (max-width: 860px) { .key, p.columns { max-width: none; columns: 2; column-gap: 40px; }
.two { grid-template-columns: 1fr; } .tree { columns: 1; } .facts { grid-template-columns: auto auto; } }
@media print {
  body { max-width: none; padding: 0; font-size: 11.5px; } nav { display: none; }
  h2 { break-after: avoid; margin-top: 28px; } figure, tr, .note, .key { break-inside: avoid; }
  table { font-size: 10.5px; } a { color: inherit; }
  * { -webkit-print-color-adjust: exact; print-color-adjust: exact; }
}
"""
