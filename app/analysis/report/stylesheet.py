"""Styles of a report's page beyond those it shares with the studies."""

REPORT_CSS = """
.menu, .facts { display: flex; flex-wrap: wrap; gap: 0.25rem 1.5rem; margin: 0.5rem 0; padding: 0; list-style: none }
.facts { color: var(--dim) }
.menu a { display: inline-block; padding: 0.6rem 0 }
.row { display: flex; flex-wrap: wrap; justify-content: space-between; align-items: end; gap: 0.5rem }
main { max-width: 1500px }
main > p, section > p, figure { max-width: 1052px }
figure { margin: 0 0 1rem }
button { font: inherit; color: inherit; background: var(--raised); border: 1px solid var(--dim); border-radius: 6px;
  padding: 0.5rem 0.8rem; cursor: pointer }
button:disabled { opacity: 0.5; cursor: default }
#grasp-course, [data-course] { height: 700px }
#grasp-stress, [data-figure="stress"] { height: 460px }
[data-figure="boxes"] { height: 430px }
#statistics tbody th { white-space: nowrap }
.grasps { max-height: 75vh; overflow: auto; margin-bottom: 1.5rem }
.grasps table { margin: 0; font-size: 0.85rem }
.grasps thead th { position: sticky; top: 0; background: var(--page); vertical-align: bottom }
.grasps :is(th, td) { padding: 0.15rem 0.45rem; white-space: nowrap }
.grasps thead th { white-space: normal }
.grasps td:nth-last-child(-n+2) { white-space: normal; min-width: 9rem }
.grasps th button { padding: 0.2rem 0.6rem; min-width: 3.2rem; min-height: 2rem }
.grasps tr.chosen { background: var(--raised) }
.spark { display: block; width: 130px; height: 34px }
.spark path { fill: none; stroke: var(--ink); stroke-width: 1.2 }
.spark .limit { stroke: var(--dim); stroke-dasharray: 4 3 }
.mark { display: inline-block; min-width: 1.5em; padding: 0 0.25em; border-radius: 3px; text-align: center;
  font-weight: 700; print-color-adjust: exact }
.over { font-weight: 700 }
@page wide { size: A4 landscape; margin: 12mm }
@media print {
  #grasps { page: wide }
  .grasps { max-height: none; overflow: visible }
  .grasps table { font-size: 7pt }
  .grasps :is(th, td) { padding: 0.05rem 0.2rem }
  .grasps thead th { position: static }
  .grasps th button { all: unset }
  .grasps tr.chosen { background: none }
  .spark { width: 80px; height: 21px }
}
"""
