// The 3D view: all points in one buffer; the slider and the switches are numbers of its shader.
"use strict";

const VERTEX_SHADER = `
  attribute float percentage;
  attribute float label;
  attribute float cluster;
  attribute float density;
  attribute float scan;
  attribute float through;
  uniform float code;
  uniform float size;
  uniform float pixels;
  uniform int mode;
  uniform vec4 shown;
  uniform vec3 colours[4];
  uniform vec2 heights;
  uniform vec3 from;
  uniform vec3 to;
  uniform float swipe;
  uniform vec2 depths;
  uniform vec3 scans;
  uniform vec3 paper;
  varying vec3 tone;

  vec3 ramp(float t) {  // viridis, as a polynomial
    t = clamp(t, 0.0, 1.0);
    const vec3 c0 = vec3(0.2777, 0.0054, 0.3341);
    const vec3 c1 = vec3(0.1051, 1.4046, 1.3846);
    const vec3 c2 = vec3(-0.3309, 0.2148, 0.0951);
    const vec3 c3 = vec3(-4.6342, -5.7991, -19.3324);
    const vec3 c4 = vec3(6.2283, 14.1799, 56.6906);
    const vec3 c5 = vec3(4.7764, -13.7451, -65.3530);
    const vec3 c6 = vec3(-5.4355, 4.6459, 26.3124);
    return c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * (c5 + t * c6)))));
  }

  vec3 ended(float t) {  // without the end that the paper swallows
    return ramp(mix(${DARK ? "0.222, 1.0" : "0.0, 0.889"}, t));
  }

  void main() {
    int kind = label > 2.5 ? 3 : label > 1.5 ? 2 : percentage <= code ? 1 : 0;
    float visible = kind == 3 ? shown.w : kind == 2 ? shown.z : kind == 1 ? shown.y : shown.x;
    float height = clamp((position.z - heights.x) / max(heights.y - heights.x, 1e-6), 0.0, 1.0);
    if (mode == 1) tone = ramp(height);
    else if (mode == 2) tone = density > 254.5 ? vec3(0.75) : ramp(density / 254.0);
    else if (mode == 4) tone = percentage > 60000.5 ? vec3(0.75) : ramp(1.0 - percentage / 60000.0);
    else if (mode == 5) tone = scan < 0.5 ? vec3(0.75) : ended((scan - 1.0) / (scans.z - 1.0));
    else if (mode == 6) tone = through < 0.0 ? vec3(0.75) : ended(through);
    else if (mode == 3) {
      int index = int(mod(cluster, 6.0));
      tone = label > 1.5 ? vec3(0.75)
        : index == 0 ? vec3(0.90, 0.62, 0.0) : index == 1 ? vec3(0.34, 0.71, 0.91)
        : index == 2 ? vec3(0.0, 0.62, 0.45) : index == 3 ? vec3(0.80, 0.47, 0.65)
        : index == 4 ? vec3(0.0, 0.45, 0.70) : vec3(0.60, 0.60, 0.10);
    } else {
      tone = kind == 3 ? colours[3] : kind == 2 ? colours[2] : kind == 1 ? colours[1] : colours[0];
      if (kind != 1) tone = mix(tone * 0.75, mix(tone, vec3(1.0), 0.3), height);
    }
    if (mode == 5 && kind != 1) tone = mix(tone, paper, 0.75);  // when ghosts were seen
    if (mode > 0 && mode < 4 && kind == 1) tone = mix(tone, colours[1], 0.35);
    vec4 seen = modelViewMatrix * vec4(position, 1.0);
    // What is far fades, so that what is near stands before it; what goes stands out anyway.
    if (kind != 1) tone = mix(tone, paper, 0.6 * smoothstep(depths.x, depths.y, -seen.z));
    vec4 placed = projectionMatrix * seen;
    if (kind == 1 && placed.x > swipe * placed.w) visible = 0.0;
    if (any(lessThan(position, from)) || any(greaterThan(position, to))) visible = 0.0;
    if (scan < scans.x || scan > scans.y) visible = 0.0;
    gl_Position = visible > 0.5 ? placed : vec4(2.0, 2.0, 2.0, 1.0);
    gl_PointSize = pixels * size * (kind == 1 ? 1.5 : 1.0);
  }`;

const FRAGMENT_SHADER = `
  varying vec3 tone;
  void main() {
    vec2 off = gl_PointCoord - vec2(0.5);
    if (dot(off, off) > 0.25) discard;
    gl_FragColor = vec4(tone, 1.0);
  }`;

const BOX_VERTEX_SHADER = `
  uniform float pixels;
  void main() {
    gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
    gl_PointSize = 2.0 * pixels;
  }`;

const BOX_FRAGMENT_SHADER =
  `void main() { gl_FragColor = vec4(${DARK ? "0.89, 0.91, 0.93" : "0.11, 0.15, 0.20"}, 1.0); }`;

// The edges of a box as dots, an axis after the other.
function boxDots(low, high, number) {
  const dots = [];
  for (let axis = 0; axis < 3; axis++) {
    for (let corner = 0; corner < 4; corner++) {
      for (let step = 0; step <= number; step++) {
        const dot = [0, 0, 0];
        dot[axis] = low[axis] + ((high[axis] - low[axis]) * step) / number;
        dot[(axis + 1) % 3] = (corner & 1 ? high : low)[(axis + 1) % 3];
        dot[(axis + 2) % 3] = (corner & 2 ? high : low)[(axis + 2) % 3];
        dots.push(...dot);
      }
    }
  }
  return new Float32Array(dots);
}

function makeScene() {
  const canvas = document.getElementById("scene-canvas");
  let renderer;
  try {
    const wanted = { antialias: true, preserveDrawingBuffer: true };
    const context = canvas.getContext("webgl2", wanted);
    if (!context) throw new Error("no WebGL");
    renderer = new THREE.WebGLRenderer({ canvas, context, ...wanted });
  } catch {
    document.getElementById("no-webgl").hidden = false;
    canvas.hidden = true;
    return null;
  }
  renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
  renderer.setClearColor(new THREE.Color(...PAPER.map((part) => part / 255)), 1);
  const { facts } = report;
  const [width, depth, height] = facts.span;
  const centre = [width / 2, depth / 2, height / 2];
  const radius = Math.hypot(width, depth, height) / 2 || 1;

  const count = facts.count;
  const position = new Float32Array(3 * count);
  for (let i = 0; i < 3 * count; i++) {
    position[i] = (report.places[i] / 65535) * facts.span[i % 3] - centre[i % 3];
  }
  const geometry = new THREE.BufferGeometry();
  const attach = (name, array, size) =>
    geometry.setAttribute(name, new THREE.BufferAttribute(array, size));
  attach("position", position, 3);
  attach("percentage", Float32Array.from(report.percentages), 1);
  attach("label", Float32Array.from(report.labels), 1);
  attach("cluster", Float32Array.from(report.clusters), 1);
  attach("density", Float32Array.from(report.densities), 1);
  if (report.scans) attach("scan", Float32Array.from(report.scans), 1);
  if (report.met) {
    const share = (through, point) => {
      const all = through + report.met[point];
      return all ? through / all : -1;
    };
    attach("through", Float32Array.from(report.through, share), 1);
  }
  const uniforms = {
    code: { value: report.state.code },
    size: { value: 2 },
    pixels: { value: 1 },
    mode: { value: 0 },
    shown: { value: [1, 1, 1, 1] },
    colours: { value: COLOURS.map((each) => new THREE.Color(...each.map((part) => part / 255))) },
    heights: { value: [-height / 2, height / 2] },
    from: { value: new THREE.Vector3(-1e9, -1e9, -1e9) },
    to: { value: new THREE.Vector3(1e9, 1e9, 1e9) },
    swipe: { value: 2 },
    depths: { value: [0, 1] },
    scans: { value: [0, 65535, report.facts.scans ? codeOf(report.facts.scans[1]) : 2] },
    paper: { value: new THREE.Color(...PAPER.map((part) => part / 255)) },
  };
  const material = new THREE.ShaderMaterial({
    uniforms, vertexShader: VERTEX_SHADER, fragmentShader: FRAGMENT_SHADER,
  });
  const cloud = new THREE.Points(geometry, material);
  cloud.frustumCulled = false;
  const scene = new THREE.Scene();
  scene.add(cloud);
  const box = new THREE.Points(new THREE.BufferGeometry(), new THREE.ShaderMaterial({
    uniforms: { pixels: uniforms.pixels },
    vertexShader: BOX_VERTEX_SHADER,
    fragmentShader: BOX_FRAGMENT_SHADER,
    depthTest: false,
  }));
  box.frustumCulled = false;
  box.visible = false;
  scene.add(box);

  const camera = new THREE.PerspectiveCamera(45, 1, radius / 500, radius * 20);
  camera.up.set(0, 0, 1);
  const controls = new THREE.OrbitControls(camera, canvas);
  let asked = false;
  const draw = () => {
    asked = false;
    const distance = camera.position.distanceTo(controls.target);
    uniforms.depths.value = [distance - 0.3 * radius, distance + 1.2 * radius];
    renderer.render(scene, camera);
    showScale(distance);
    showPins();
  };
  const ask = () => {
    if (!asked) requestAnimationFrame(draw);
    asked = true;
  };
  controls.addEventListener("change", ask);

  function showScale(distance) {
    const scale = document.getElementById("scale");
    const pixel = 2 * distance * Math.tan((camera.fov * Math.PI) / 360) / canvas.clientHeight;
    const length = roundBelow(150 * pixel);
    scale.firstElementChild.style.width = `${(length / pixel).toFixed(0)}px`;
    scale.lastElementChild.textContent = metres(length);
  }
  // Where a place of the map is on the canvas, in pixels; null behind the camera.
  const placed = new THREE.Vector3();
  function onCanvas(x, y, z) {
    placed.set(x, y, z).project(camera);
    if (placed.z > 1) return null;
    return [(placed.x + 1) / 2 * canvas.clientWidth, (1 - placed.y) / 2 * canvas.clientHeight];
  }
  const isClipped = (x, y, z) => [x, y, z].some((value, axis) =>
    value < uniforms.from.value.getComponent(axis) || value > uniforms.to.value.getComponent(axis));
  const isInTime = (point) => {
    const [from, to] = uniforms.scans.value;
    return !report.scans || (report.scans[point] >= from && report.scans[point] <= to);
  };
  let pins = [];
  function showPins() {
    for (const { span, at } of pins) {
      const pixel = onCanvas(...at);
      span.hidden = !pixel || isClipped(...at) || !report.state.removed;
      if (pixel) span.style.translate = `${pixel[0].toFixed(0)}px ${pixel[1].toFixed(0)}px`;
    }
  }
  function pin(places) {
    pins = places.map((place) => {
      const span = document.createElement("span");
      span.textContent = place.number;
      const at = place.low.map((low, axis) => (low + place.high[axis]) / 2 - facts.low[axis] - centre[axis]);
      return { span, at };
    });
    document.getElementById("pins").replaceChildren(...pins.map(({ span }) => span));
  }
  // The nearest point to the camera within some pixels of a click.
  function pick(x, y) {
    let best = -1, least = Infinity;
    const behind = camera.position.clone();
    for (let i = 0; i < count; i++) {
      const at = [position[3 * i], position[3 * i + 1], position[3 * i + 2]];
      if (!report.state[KINDS[kindOf(i)]] || isClipped(...at) || !isInTime(i)) continue;
      const pixel = onCanvas(...at);
      if (!pixel) continue;
      const off = Math.hypot(pixel[0] - x, pixel[1] - y);
      if (off > 7) continue;
      const far = Math.hypot(at[0] - behind.x, at[1] - behind.y, at[2] - behind.z) + off * radius / 100;
      if (far < least) [best, least] = [i, far];
    }
    if (best < 0) return null;
    const xyz = [0, 1, 2].map((axis) => position[3 * best + axis] + centre[axis] + facts.low[axis]);
    return { xyz, kind: KINDS[kindOf(best)], seen: seenInWords([best]) };
  }
  let pressed = null;
  canvas.addEventListener("pointerdown", (event) => { pressed = [event.clientX, event.clientY]; });
  canvas.addEventListener("pointerup", (event) => {
    if (!pressed || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 3) return;
    const box = canvas.getBoundingClientRect();
    const found = pick(event.clientX - box.left, event.clientY - box.top);
    const told = document.getElementById("picked");
    told.hidden = !found;
    if (found) {
      const written = found.xyz.map((value) => value.toFixed(2)).join(", ");
      const kind = found.kind === "other" ? "not scored" : found.kind;
      told.textContent = `${written} m: ${[kind, found.seen].filter(Boolean).join("; ")}`;
    }
  });
  // Some of the points stand for all; the middle of nearly all of them is what the view turns about.
  const some = [];
  for (let i = 0; i < count; i += Math.ceil(count / 4000)) {
    some.push(new THREE.Vector3().fromArray(position, 3 * i));
  }
  const quantile = (values, share) => {
    const sorted = Float32Array.from(values).sort();
    return sorted.length ? sorted[Math.floor(share * (sorted.length - 1))] : 0;
  };
  const middle = new THREE.Vector3(...["x", "y", "z"].map((axis) => {
    const values = some.map((place) => place[axis]);
    return (quantile(values, 0.02) + quantile(values, 0.98)) / 2;
  }));

  function lookFrom(x, y, z) {
    controls.target.copy(middle);
    const toward = new THREE.Vector3(x, y, z).normalize();
    camera.position.copy(middle).addScaledVector(toward, radius);
    controls.update();
    camera.updateMatrixWorld();
    const [right, up] = [0, 1].map((axis) => new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, axis));
    const tangent = Math.tan((camera.fov * Math.PI) / 360);
    // As near as nearly all points allow.
    const needed = some.map((place) => {
      const from = place.clone().sub(middle);
      const beside = Math.abs(from.dot(right)) / camera.aspect, above = Math.abs(from.dot(up));
      return from.dot(toward) + Math.max(beside, above) / tangent;
    });
    const distance = Math.max(1.06 * quantile(needed, 0.99), radius / 100);
    camera.position.copy(middle).addScaledVector(toward, distance);
    controls.update();
    ask();
  }
  // From where one looks now, but at a box, and so near that it fills the view.
  function visit(from, to, framed = true) {
    const [low, high] = [from, to].map((corner) =>
      corner.map((value, axis) => value - facts.low[axis] - centre[axis]));
    const toward = camera.position.clone().sub(controls.target).normalize();
    const size = Math.hypot(...high.map((end, axis) => end - low[axis]));
    const distance = (1.3 * size) / Math.min(1, camera.aspect);
    controls.target.set(...high.map((end, axis) => (end + low[axis]) / 2));
    camera.position.copy(controls.target).addScaledVector(toward, Math.max(distance, 3));
    controls.update();
    box.geometry.setAttribute("position", new THREE.BufferAttribute(boxDots(low, high, 200), 3));
    box.visible = framed;
    ask();
  }
  function turn(around, up) {
    const offset = camera.position.clone().sub(controls.target);
    const length = offset.length();
    const angle = Math.atan2(offset.y, offset.x) + around;
    const rise = Math.min(1.55, Math.max(-1.55, Math.asin(offset.z / length) + up));
    offset.set(Math.cos(rise) * Math.cos(angle), Math.cos(rise) * Math.sin(angle), Math.sin(rise));
    camera.position.copy(controls.target).addScaledVector(offset, length);
    controls.update();
    ask();
  }
  function approach(factor) {
    camera.position.sub(controls.target).multiplyScalar(factor).add(controls.target);
    controls.update();
    ask();
  }
  const keys = {
    ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0),
    ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1),
    "+": () => approach(0.85), "=": () => approach(0.85), "-": () => approach(1.18),
  };
  canvas.addEventListener("keydown", (event) => {
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  });
  function fit() {
    const box = canvas.parentElement;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    renderer.setPixelRatio(ratio);
    renderer.setSize(box.clientWidth, box.clientHeight, false);
    uniforms.pixels.value = ratio;
    camera.aspect = box.clientWidth / Math.max(box.clientHeight, 1);
    camera.updateProjectionMatrix();
    ask();
  }
  fit();
  new ResizeObserver(fit).observe(canvas.parentElement);
  // The longer side of the map lies across the view.
  const oblique = () => (depth > width ? lookFrom(1.4, -0.5, 1.0) : lookFrom(-0.5, -1.4, 1.0));
  oblique();
  return {
    visit,
    update() {
      uniforms.code.value = report.state.code;
      uniforms.shown.value = KINDS.map((kind) => (report.state[kind] ? 1 : 0));
      ask();
    },
    colour(mode) { uniforms.mode.value = mode; ask(); },
    size(value) { uniforms.size.value = value; ask(); },
    // What lies between two corners is shown, in the map's coordinates.
    clip(low, high) {
      const local = (corner) => corner.map((value, axis) => value - facts.low[axis] - centre[axis]);
      uniforms.from.value.fromArray(local(low));
      uniforms.to.value.fromArray(local(high));
      ask();
    },
    // What these scans saw is shown; where all are, also what nobody knows when it was seen.
    time(first, last) {
      const { scans } = report.facts, all = first === scans[0] && last === scans[1];
      uniforms.scans.value = [all ? 0 : codeOf(first), codeOf(last), codeOf(scans[1])];
      ask();
    },
    swipe(share) { uniforms.swipe.value = share >= 1 ? 2 : 2 * share - 1; ask(); },
    pin,
    whole() { box.visible = false; oblique(); },
    fromAbove() { lookFrom(0, -0.001, 1); },
    fromSide() { if (depth > width) lookFrom(1, 0, 0.02); else lookFrom(0, -1, 0.02); },
  };
}
