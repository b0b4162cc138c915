// The sample: typed arrays, a value (or three) for each point.
"use strict";

const report = (() => {
  const text = (name) => document.getElementById(name).textContent;
  const bytes = (name) => {
    const raw = atob(text(`array-${name}`));
    const array = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) array[i] = raw.charCodeAt(i);
    return array;
  };
  const facts = JSON.parse(text("facts"));
  return {
    facts,
    places: new Uint16Array(bytes("places").buffer),
    percentages: new Uint16Array(bytes("percentages").buffer),
    labels: bytes("labels"),
    clusters: bytes("clusters"),
    densities: bytes("densities"),
    // What the slider and the switches say; 600 codes are a percent.
    state: { code: facts.own_code, static: true, removed: true, ground: true, other: true },
  };
})();

// 0 static, 1 removed, 2 ground, 3 other: labels above 2 were set aside or not scored.
function kindOf(point) {
  const label = report.labels[point];
  if (label === 2) return 2;
  if (label > 2) return 3;
  return report.percentages[point] <= report.state.code ? 1 : 0;
}

const KINDS = ["static", "removed", "ground", "other"];
const DARK = window.matchMedia("(prefers-color-scheme: dark)").matches;
const COLOURS = DARK ? [[91, 155, 208], [255, 133, 51], [122, 117, 106], [204, 121, 167]]
  : [[43, 108, 163], [213, 94, 0], [154, 147, 132], [204, 121, 167]];
const PAPER = DARK ? [24, 32, 42] : [255, 255, 255];

function metres(value) {
  const digits = Math.abs(value) < 10 ? 2 : Math.abs(value) < 1000 ? 1 : 0;
  return `${value.toLocaleString("en-GB", { maximumFractionDigits: digits })} m`;
}
