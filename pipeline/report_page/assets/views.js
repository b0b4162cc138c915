// Top view and section: the points counted by pixel, darker where there are more, with axes in metres.
"use strict";

const MARGIN = { left: 58, right: 10, top: 8, bottom: 38 };

// The largest of 1, 2 and 5 times a power of ten that is not above a number.
function roundBelow(value) {
  const size = 10 ** Math.floor(Math.log10(value));
  return size * [5, 2, 1].find((each) => each * size <= value * 1.0001);
}

// Round numbers between two others, about as many as fit.
function ticksBetween(low, high, count) {
  const rough = (high - low) / Math.max(count, 1);
  if (!(rough > 0)) return [low];
  const size = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * size).find((each) => each >= rough * 0.999);
  const ticks = [];
  for (let n = Math.ceil(low / step - 1e-9); n * step <= high + 1e-9 * step; n++) ticks.push(n ? n * step : 0);
  return ticks;
}

class View {
  // `axes` are the two coordinates shown, across and up.
  constructor(canvas, removedShown) {
    this.canvas = canvas;
    this.removedShown = removedShown;
  }

  draw(axes, slice) {
    const { facts } = report;
    const [across, up] = axes;
    const low = [facts.low[across], facts.low[up]];
    const span = [facts.span[across], facts.span[up]];
    const wide = this.canvas.parentElement.clientWidth;
    if (!wide) return;
    const room = wide - MARGIN.left - MARGIN.right;
    // One scale for both axes; a map that is long and low gets a picture that is.
    const scale = Math.min(room / span[0], 460 / span[1]);
    const width = Math.max(1, Math.round(span[0] * scale));
    const height = Math.max(24, Math.round(span[1] * scale));
    const tall = height + MARGIN.top + MARGIN.bottom;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    this.canvas.width = Math.round(wide * ratio);
    this.canvas.height = Math.round(tall * ratio);
    this.canvas.style.height = `${tall}px`;
    const context = this.canvas.getContext("2d");
    context.scale(ratio, ratio);
    context.fillStyle = `rgb(${PAPER.join(" ")})`;
    context.fillRect(0, 0, wide, tall);
    this.points(context, axes, slice, width, height, scale, ratio);
    this.frame(context, low, span, width, height, scale, axes);
  }

  points(context, axes, slice, width, height, scale, ratio) {
    const { places, facts } = report;
    const [across, up] = axes;
    const columns = Math.round(width * ratio), rows = Math.round(height * ratio);
    const pixel = scale * ratio;
    const counts = KINDS.map(() => new Uint16Array(columns * rows));
    for (let point = 0; point < facts.count; point++) {
      if (slice) {
        const beside = (places[3 * point + slice.axis] / 65535) * facts.span[slice.axis];
        if (beside < slice.from || beside > slice.to) continue;
      }
      const kind = kindOf(point);
      if (!report.state[KINDS[kind]] || (kind === 1 && !this.removedShown)) continue;
      const x = (places[3 * point + across] / 65535) * facts.span[across] * pixel;
      const y = (places[3 * point + up] / 65535) * facts.span[up] * pixel;
      const column = Math.min(columns - 1, Math.floor(x));
      const row = rows - 1 - Math.min(rows - 1, Math.floor(y));
      counts[kind][row * columns + column]++;
    }
    this.paint(context, counts, columns, rows);
  }

  paint(context, counts, columns, rows) {
    const image = context.createImageData(columns, rows);
    const shade = (count) => 1 - 0.62 * Math.exp(-count / 2.5);
    const put = (at, colour, weight) => {
      for (let part = 0; part < 3; part++) {
        image.data[4 * at + part] = Math.round(PAPER[part] + (colour[part] - PAPER[part]) * weight);
      }
      image.data[4 * at + 3] = 255;
    };
    const blend = (at, weight) => {
      const isFree = !image.data[4 * at + 3];
      for (let part = 0; part < 3; part++) {
        const below = isFree ? PAPER[part] : image.data[4 * at + part];
        image.data[4 * at + part] = Math.round(below + (COLOURS[1][part] - below) * weight);
      }
      image.data[4 * at + 3] = 255;
    };
    for (let at = 0; at < columns * rows; at++) {
      // Static over ground over what was not scored.
      for (const kind of [3, 2, 0]) {
        if (counts[kind][at]) put(at, COLOURS[kind], shade(counts[kind][at]));
      }
    }
    // What goes is marked by its share of a pixel; a point on its own is two pixels wide.
    for (let row = 0; row < rows; row++) {
      for (let column = 0; column < columns; column++) {
        const at = row * columns + column;
        if (!counts[1][at]) continue;
        const others = counts[0][at] + counts[2][at] + counts[3][at];
        const weight = 0.4 + 0.6 * Math.sqrt(counts[1][at] / (counts[1][at] + others));
        blend(at, weight);
        const isFree = column + 1 < columns && !image.data[4 * at + 7];
        if (isFree) blend(at + 1, weight);
      }
    }
    const ratio = context.getTransform().a;
    context.putImageData(image, Math.round(MARGIN.left * ratio), Math.round(MARGIN.top * ratio));
  }

  frame(context, low, span, width, height, scale, axes) {
    const names = ["x", "y", "z"];
    const right = MARGIN.left + width, bottom = MARGIN.top + height;
    context.strokeStyle = DARK ? "#71808e" : "#8794a1";
    context.lineWidth = 1;
    context.strokeRect(MARGIN.left - 0.5, MARGIN.top - 0.5, width + 1, height + 1);
    context.fillStyle = DARK ? "#9aa8b5" : "#5a6875";
    context.font = '11px system-ui, "Liberation Sans", sans-serif';
    const write = (value) => (value || 0).toLocaleString("en-GB", { maximumFractionDigits: 2 });
    context.textAlign = "center";
    for (const tick of ticksBetween(low[0], low[0] + span[0], Math.min(7, width / 80))) {
      const x = MARGIN.left + (tick - low[0]) * scale;
      if (x > right + 0.5) continue;
      context.fillRect(x, bottom, 1, 4);
      context.fillText(write(tick), x, bottom + 15);
    }
    context.fillText(`${names[axes[0]]}, m`, (MARGIN.left + right) / 2, bottom + 30);
    context.textAlign = "right";
    for (const tick of ticksBetween(low[1], low[1] + span[1], Math.min(6, height / 30))) {
      const y = bottom - (tick - low[1]) * scale;
      if (y < MARGIN.top - 0.5) continue;
      context.fillRect(MARGIN.left - 4, y, 4, 1);
      context.fillText(write(tick), MARGIN.left - 7, y + 4);
    }
    context.save();
    context.translate(11, MARGIN.top + height / 2);
    context.rotate(-Math.PI / 2);
    context.textAlign = "center";
    context.fillText(`${names[axes[1]]}, m`, 0, 0);
    context.restore();
  }
}
