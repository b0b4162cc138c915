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
  // Numbers of one byte, or of two, each; null where the page holds none.
  const narrow = (name) => {
    if (!document.getElementById(`array-${name}`)) return null;
    const array = bytes(name);
    return array.length === facts.count ? array : new Uint16Array(array.buffer);
  };
  return {
    facts,
    places: new Uint16Array(bytes("places").buffer),
    percentages: new Uint16Array(bytes("percentages").buffer),
    labels: bytes("labels"),
    clusters: bytes("clusters"),
    densities: bytes("densities"),
    // Scans from 1 on, 0 where not known; how many met the place of a point, and saw through it.
    scans: narrow("scans"),
    met: narrow("met"),
    through: narrow("through"),
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

// A scan's number, and the number that stands for it here: from 1 to the last.
const SCAN_STEP = report.facts.scans
  ? Math.max((report.facts.scans[1] - report.facts.scans[0]) / 65534, 1) : 1;
const scanOf = (code) => Math.round(report.facts.scans[0] + (code - 1) * SCAN_STEP);
const codeOf = (scan) => 1 + Math.round((scan - report.facts.scans[0]) / SCAN_STEP);

// When some points were seen, and what scans saw of them, in the median, in words.
function seenInWords(points) {
  const sorted = (values, of) => Array.from(of, (point) => values[point]).sort((a, b) => a - b);
  const told = [];
  const codes = report.scans ? sorted(report.scans, points).filter(Boolean) : [];
  if (codes.length) {
    const [first, last] = [scanOf(codes[0]), scanOf(codes[codes.length - 1])];
    told.push(first === last ? `scan ${first}` : `scans ${first} to ${last}`);
  }
  if (report.met && points.length) {
    const [met, through] = [report.met, report.through].map(
      (counts) => sorted(counts, points)[points.length >> 1].toLocaleString("en-GB"));
    const which = points.length > 1 ? "typically " : "";
    told.push(`${which}met by ${met} scan${met === "1" ? "" : "s"}, seen through by ${through}`);
  }
  return told.join("; ");
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
