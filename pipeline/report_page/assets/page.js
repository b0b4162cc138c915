// Slider, switches and sections, and all that follows them.
"use strict";

(() => {
  const { facts, state } = report;
  const byId = (name) => document.getElementById(name);
  const written = (number) => number.toLocaleString("en-GB");
  const rounded = (number) => Number(number.toFixed(4));
  // The slider is a share, or the confidence: then the percentage is what it lacks of certainty.
  const byScore = facts.confidence !== null;
  const turned = (value) => (byScore ? 100 - 100 * value : value);
  const found = JSON.parse(byId("run").textContent).places;
  const scene = makeScene();
  const views = ["before", "after"].map((when) => ({
    top: new View(byId(`top-${when}`), when === "before"),
    section: new View(byId(`section-${when}`), when === "before"),
  }));

  // Where most of what the run removed lies, and how thick a slice holds enough points to be read.
  const section = { across: facts.span[1] > facts.span[0] ? 1 : 0, place: 0.5, thickness: 1 };
  function mostRemoved(axis) {
    const bins = new Uint32Array(40);
    for (let point = 0; point < facts.count; point++) {
      if (kindOf(point) === 1) bins[Math.min(39, (report.places[3 * point + axis] * 40) >> 16)]++;
    }
    return (bins.indexOf(Math.max(...bins)) + 0.5) / 40;
  }
  function offerThickness() {
    const span = facts.span[1 - section.across];
    const choices = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100].filter((each) => each < span);
    const wanted = span * Math.min(1, Math.max(0.02, 9000 / Math.max(facts.count, 1)));
    const options = [...choices, span];
    section.thickness = options.find((each) => each >= wanted) || span;
    byId("thickness").replaceChildren(...options.map((each) => {
      const all = each === span;
      const option = new Option(all ? "all of it" : metres(each), each);
      option.selected = each === section.thickness;
      return option;
    }));
  }
  function direct(across) {
    section.across = across;
    section.place = mostRemoved(1 - across);
    byId("direction").value = across;
    byId("place").value = Math.round(1000 * section.place);
    offerThickness();
  }

  function drawSection() {
    const axis = 1 - section.across;
    const middle = section.place * facts.span[axis];
    const half = section.thickness / 2;
    const slice = { axis, from: middle - half, to: middle + half };
    byId("place-value").textContent =
      `${axis ? "y" : "x"} = ${metres(facts.low[axis] + middle)}`;
    for (const view of views) view.section.draw([section.across, 2], slice);
  }
  function drawViews() {
    for (const view of views) view.top.draw([0, 1], null);
    drawSection();
  }
  let asked = false;
  function draw() {
    if (scene) scene.update();
    if (!asked) requestAnimationFrame(() => { asked = false; drawViews(); });
    asked = true;
  }

  // Where a cluster would be cut, between two entries of a table of whole percents.
  function drawCuts(percentage) {
    for (const line of document.querySelectorAll("path.cut")) {
      const places = line.dataset.places.split(",");
      const low = Math.floor(percentage), high = Math.min(low + 1, 100);
      const [from, to] = line.dataset.line.split(" ");
      const ends = [places[low], places[high]];
      if (ends[1] === "" || percentage === 0) { line.setAttribute("d", "M0 0"); continue; }
      const start = Number(ends[0] === "" ? ends[1] : ends[0]);
      const at = start + (Number(ends[1]) - start) * (percentage - low);
      line.setAttribute("d", `M${at.toFixed(1)} ${from}V${to}`);
    }
  }

  function setPercentage(percentage, isOwn) {
    state.code = isOwn ? facts.own_code : Math.round(600 * percentage);
    const removed = isOwn ? facts.removed
      : facts.removed_points[Math.round(percentage / facts.table_step)];
    const share = facts.total ? (100 * removed) / facts.total : 0;
    const value = !byScore ? percentage : isOwn ? facts.confidence : 1 - percentage / 100;
    byId("percentage-value").textContent = rounded(value) + (byScore ? "" : " %");
    byId("removed-count").textContent = written(removed);
    const percent = removed && share < 0.1 ? "under 0.1" : share.toFixed(1);
    byId("removed-share").textContent = `points, ${percent} % of the map,`;
    byId("removed-kind").textContent = isOwn ? "removed in this run" : "would be removed";
    const least = isOwn ? facts.min_percent : percentage * facts.min_ratio;
    const wanted = byScore ? `removal.confidence=${rounded(value)}`
      : `removal.min_percent=${rounded(least)} --set removal.max_percent=${rounded(percentage)}`;
    const settings = byScore && facts.apply ? `--confidence ${rounded(value)}` : `--set ${wanted}`;
    byId("settings").textContent = facts.apply ? `${facts.apply} ${settings}` : settings;
    drawCuts(percentage);
    draw();
  }
  function reset() {
    byId("percentage").value = byScore ? facts.confidence : facts.own;
    setPercentage(facts.own, true);
  }

  byId("percentage").addEventListener("input", (event) => {
    const percentage = turned(Number(event.target.value));
    const nearest = Math.abs(percentage - facts.own) <= facts.table_step / 2;
    setPercentage(nearest ? facts.own : percentage, nearest);
  });
  byId("reset").addEventListener("click", reset);
  byId("copy").addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(byId("settings").textContent);
      byId("copy").textContent = "Copied";
    } catch {
      window.getSelection().selectAllChildren(byId("settings"));
    }
  });
  for (const kind of KINDS) {
    byId(`show-${kind}`).addEventListener("change", (event) => {
      state[kind] = event.target.checked;
      draw();
    });
  }
  const hasOther = report.labels.some((label) => label > 2);
  byId("show-other").parentElement.hidden = !hasOther;
  byId("direction").addEventListener("change", (event) => {
    direct(Number(event.target.value));
    drawSection();
  });
  byId("place").addEventListener("input", (event) => {
    section.place = Number(event.target.value) / 1000;
    drawSection();
  });
  byId("thickness").addEventListener("change", (event) => {
    section.thickness = Number(event.target.value);
    drawSection();
  });
  byId("outside").textContent = facts.outside
    ? `Not shown, as far away from all others: ${written(facts.outside)} of these points.`
    : "";

  // The box that is shown in 3D, and the sliders that set it.
  const ends = [facts.low.map(Number), facts.low.map((low, axis) => low + facts.span[axis])];
  const shown = ends.map((corner) => [...corner]);
  const clips = [...document.querySelectorAll("[data-clip]")].map((input) =>
    ({ input, axis: "xyz".indexOf(input.dataset.clip), end: Number(input.dataset.end) }));
  function clip() {
    for (const { input, axis, end } of clips) {
      input.value = Math.round(1000 * (shown[end][axis] - facts.low[axis]) / (facts.span[axis] || 1));
      input.parentElement.lastElementChild.textContent =
        `${metres(shown[0][axis])} to ${metres(shown[1][axis])}`;
    }
    const cut = ["x", "y", "z"].filter((name, axis) =>
      shown[0][axis] > ends[0][axis] || shown[1][axis] < ends[1][axis]);
    byId("clipped").textContent = !cut.length ? "all is shown"
      : cut.join() === "z" ? `z up to ${metres(shown[1][2])}` : `in ${cut.join(", ")}`;
    if (scene) scene.clip(...shown);
  }
  for (const { input, axis, end } of clips) {
    input.addEventListener("input", () => {
      const share = Number(input.value) / 1000;
      const value = share === end ? ends[end][axis] : facts.low[axis] + share * facts.span[axis];
      shown[end][axis] = end ? Math.max(value, shown[0][axis]) : Math.min(value, shown[1][axis]);
      clip();
    });
  }
  function unclip() {
    ends.forEach((corner, end) => { shown[end] = [...corner]; });
    clip();
  }
  byId("unclip").addEventListener("click", unclip);
  // A ceiling hides what is under it: a layer high above the middle of the ground, with many points.
  function belowCeiling() {
    const step = Math.max(0.1, facts.span[2] / 400);
    const bins = new Uint32Array(Math.ceil(facts.span[2] / step) + 1);
    const ground = [];
    for (let point = 0; point < facts.count; point++) {
      const z = (report.places[3 * point + 2] / 65535) * facts.span[2];
      if (kindOf(point) === 2) ground.push(z);
      else bins[Math.floor(z / step)]++;
    }
    if (!ground.length) return null;
    const floor = ground.sort((one, other) => one - other)[ground.length >> 1];
    const first = Math.ceil((floor + 1.9) / step);
    let layer = -1;
    for (let bin = first; bin < bins.length; bin++) if (layer < 0 || bins[bin] > bins[layer]) layer = bin;
    const beneath = [...bins.slice(Math.ceil((floor + 1) / step), Math.max(layer - 1, 0))];
    const usual = beneath.sort((one, other) => one - other)[beneath.length >> 1] || 0;
    const most = bins[layer];
    if (layer < 0 || most < 0.03 * facts.count || most < 1.8 * usual) return null;
    // Where the floor rises, so does the ceiling: its layer is as deep.
    while (layer > first && bins[layer - 1] > Math.max(1.3 * usual, 0.3 * most)) layer--;
    return facts.low[2] + (layer - 1) * step - 0.1;
  }
  const ceiling = belowCeiling();
  if (ceiling !== null) shown[1][2] = ceiling;

  if (facts.files.length) {
    byId("file").addEventListener("change", (event) => {
      const file = facts.files[event.target.value];
      if (!file) return;
      unclip();
      if (scene) scene.visit(file.low, file.high);
    });
  }

  // The sampled points that a place lost.
  function pointsOf({ low, high }) {
    const points = [];
    for (let point = 0; point < facts.count; point++) {
      const isIn = low.every((from, axis) => {
        const at = facts.low[axis] + (report.places[3 * point + axis] / 65535) * facts.span[axis];
        return at >= from && at <= high[axis];
      });
      if (isIn && kindOf(point) === 1) points.push(point);
    }
    return points;
  }
  function visit(place) {
    for (let axis = 0; axis < 3; axis++) {  // none of it is hidden
      if (place.low[axis] < shown[0][axis]) shown[0][axis] = ends[0][axis];
      if (place.high[axis] > shown[1][axis]) shown[1][axis] = Math.min(place.high[axis], ends[1][axis]);
    }
    clip();
    for (const button of document.querySelectorAll("[data-place]")) {
      button.classList.toggle("chosen", Number(button.dataset.place) === place.number);
    }
    if (scene) {
      scene.visit(place.low, place.high);
      const words = seenInWords(pointsOf(place));
      byId("picked").textContent = `place ${place.number}: ${words}`;
      byId("picked").hidden = !words;
    }
    const axis = 1 - section.across;
    section.place = ((place.low[axis] + place.high[axis]) / 2 - facts.low[axis]) / facts.span[axis];
    byId("place").value = Math.round(1000 * section.place);
    drawSection();
    if (!scene) byId("section-before").closest("section").scrollIntoView();
  }
  for (const button of document.querySelectorAll("[data-place]")) {
    button.addEventListener("click", () => visit(found[button.dataset.place - 1]));
  }

  if (facts.scans && scene) {
    const [first, last] = facts.scans;
    const [from, to] = ["scan-from", "scan-to"].map(byId);
    const isWhole = () => Number(from.value) === first && Number(to.value) === last;
    let playing = null;
    const show = (start, end) => {
      [from.value, to.value] = [start, end];
      byId("scans-shown").textContent = isWhole() ? "all" : `${from.value} to ${to.value}`;
      scene.time(Number(from.value), Number(to.value));
    };
    const stop = () => {
      clearInterval(playing);
      playing = null;
      byId("play").textContent = "Play";
    };
    const slide = (moved, other, pick) => moved.addEventListener("input", () => {
      stop();
      other.value = pick(Number(moved.value), Number(other.value));
      show(from.value, to.value);
    });
    slide(from, to, Math.max);
    slide(to, from, Math.min);
    // What a few scans saw, one after the other.
    byId("play").addEventListener("click", () => {
      if (playing !== null) return stop();
      const before = [from.value, to.value];
      const wide = isWhole() ? Math.ceil((last - first) / 20) : to.value - from.value;
      const step = Math.ceil((last - first) / 100);
      let start = first;
      const next = () => {
        if (start + wide > last) {
          stop();
          return show(...before);
        }
        show(start, start + wide);
        start += step;
      };
      playing = setInterval(next, Math.max(100, 5000 / (last - first)));
      byId("play").textContent = "Stop";
      return next();
    });
    show(first, last);
  }

  byId("swipe").addEventListener("input", (event) => {
    const share = Number(event.target.value) / 1000;
    byId("swipe-line").hidden = share >= 1;
    byId("swipe-line").style.left = `${100 * share}%`;
    if (scene) scene.swipe(share);
  });
  if (scene) {
    scene.pin(found.slice(0, 30));
    byId("whole").addEventListener("click", scene.whole);
    const ends = { 5: (facts.scans || []).map((scan) => `scan ${scan}`), 6: ["met by all", "seen through by all"] };
    byId("colour").addEventListener("change", ({ target: { value } }) => {
      scene.colour(Number(value));
      const ramp = byId("ramp");
      ramp.hidden = !ends[value];
      if (!ramp.hidden) [ramp.firstElementChild.textContent, ramp.lastElementChild.textContent] = ends[value];
    });
    byId("size").addEventListener("input", (event) => scene.size(Number(event.target.value)));
    byId("from-above").addEventListener("click", scene.fromAbove);
    byId("from-side").addEventListener("click", scene.fromSide);
  }
  for (const control of document.querySelectorAll("input, select, button")) {
    control.disabled = !scene && control.closest(".in-scene") !== null;
  }
  direct(section.across);
  clip();
  reset();
  let width = 0;
  new ResizeObserver(() => {
    if (document.body.clientWidth !== width) draw();
    width = document.body.clientWidth;
  }).observe(document.body);
  document.documentElement.dataset.ready = "yes";
})();
