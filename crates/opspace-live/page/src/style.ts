//! Style of canvas and labels, the same in the live page and in a report.

export const SCENE_STYLE = `
.stage canvas { position: absolute; inset: 0; width: 100%; height: 100%; display: block; cursor: grab; outline-offset: -2px }
.stage canvas:active { cursor: grabbing }
.stage .labels { position: absolute; inset: 0; overflow: hidden; pointer-events: none; font: 12px/1 system-ui, sans-serif }
.stage .label { position: absolute; left: 0; top: 0; white-space: nowrap; margin: -1.1em 0 0 0.5em; color: #3a4249;
  text-shadow: 0 0 3px #fff, 0 0 3px #fff, 0 0 3px #fff }
.stage .label[hidden] { display: none }
.stage .label.axis { margin: -0.5em 0 0 -0.3em; font-weight: 600; color: #6b747d }
.stage .label.reference { color: #0063a0 }
.stage .label.force { color: #b04400; font-weight: 600; font-size: 13px; font-variant-numeric: tabular-nums }
.stage .label.hand { color: #98206f; font-weight: 700; font-size: 15px; font-variant-numeric: tabular-nums }
.stage .label.environment { color: #5b636b }
@media screen and (prefers-color-scheme: dark) {
  .stage .label { color: #c7cdd3; text-shadow: 0 0 3px #000, 0 0 3px #000, 0 0 3px #000 }
  .stage .label.axis { color: #8d969f }
  .stage .label.reference { color: #6cbdf5 }
  .stage .label.force { color: #ff9a5c }
  .stage .label.hand { color: #f78fd2 }
  .stage .label.environment { color: #a2abb3 }
}
`;
