/* Charts that zoom and show their values. Charts of one horizontal axis share the span that is shown and the cursor. Nothing is loaded: values
   are read from the curves that plot.rs has drawn. Without this script the page is the same and stands still. */
"use strict";
(() => {
  /* As in plot.rs: steps of a curve in a pixel, and the part of the range that is left empty above and below. */
  const STEPS = 100;
  const MARGIN = 0.06;
  /* The narrowest span, as a part of the whole axis: a curve has some 3000 points. */
  const NARROWEST = 1 / 200;
  /* The lowest range of a magnified chart, as a part of the whole one: a curve has some 13000 steps in its height. */
  const LOWEST = 1 / 100;
  /* A pointer that moves less than this between down and up, px, has selected nothing. */
  const LEAST_DRAG = 6;
  /* Shares of the span by which a key moves the cursor, without and with Shift. */
  const KEY_STEPS = [0.01, 0.1];

  const numbers = text => text.split(" ").map(Number);
  const scaled = (value, [from, to], start, end) => start + (value - from) / (to - from) * (end - start);
  const clamped = (value, [from, to]) => Math.min(Math.max(value, from), to);
  const written = (value, decimals) => value.toFixed(clamped(decimals, [0, 9])).replace(/^-(?=[0.]*$)/, "").replace("-", "−");
  const magnitude = ([from, to]) => Math.floor(Math.log10(to - from));

  /* Round numbers with their texts; as in plot.rs. */
  function ticks([from, to], wanted) {
    const rough = (to - from) / Math.max(wanted, 1);
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [1, 2, 5, 10].find(factor => factor * power >= rough * 0.999);
    const found = [];
    for (let i = Math.ceil(from / step - 1e-9); i * step <= to + step * 1e-9; i++) {
      found.push([i * step, written(i * step + 0, -Math.floor(Math.log10(step)))]);
    }
    return found;
  }

  /* A curve, with the numbers at which a stretch begins that has no line to the point before. */
  class Curve {
    constructor(path, chart) {
      this.name = path.dataset.name;
      this.colour = [...path.classList].find(each => /^c\d$/.test(each));
      this.isDots = path.classList.contains("dots");
      this.x = [];
      this.y = [];
      this.begins = new Set();
      let [x, y] = [0, 0];
      for (const stretch of path.getAttribute("d").split("m").slice(1)) {
        this.begins.add(this.x.length);
        const steps = stretch.match(/-?\d+/g);
        for (let i = 0; i < steps.length; i += 2) {
          x += Number(steps[i]);
          y += Number(steps[i + 1]);
          this.x.push(scaled(x / STEPS, [chart.left, chart.right], ...chart.x));
          this.y.push(scaled(y / STEPS, [chart.bottom, chart.top], ...chart.y));
        }
      }
    }

    /* The number of the first point at or behind a place. */
    after(at) {
      let [low, high] = [0, this.x.length];
      while (low < high) {
        const middle = (low + high) >> 1;
        if (this.x[middle] < at) low = middle + 1; else high = middle;
      }
      return low;
    }

    /* The value on the line at a place, or of the nearest dot; null where there is none. */
    value(at) {
      const { x, y } = this;
      const i = this.after(at);
      if (this.isDots) {
        const near = i > 0 && (i === x.length || at - x[i - 1] < x[i] - at) ? i - 1 : i;
        return Math.abs(x[near] - at) <= 5 * (x.at(-1) - x[0]) / this.begins.size ? y[near] : null;
      }
      if (x[i] === at) return y[i];
      if (i === 0 || i === x.length || this.begins.has(i)) return null;
      return scaled(at, [x[i - 1], x[i]], y[i - 1], y[i]);
    }
  }

  class Chart {
    constructor(svg) {
      this.svg = svg;
      this.axis = svg.dataset.axis;
      [this.left, this.top, this.right, this.bottom] = numbers(svg.dataset.plot);
      this.x = numbers(svg.dataset.x);
      this.y = svg.dataset.y && numbers(svg.dataset.y);
      this.shown = this.x;
      this.range = this.y;
      /* Of a map, which has one scale: name and unit of its upright axis. */
      this.map = svg.dataset.map;
      this.grids = [...svg.querySelectorAll(".across, .up")].map(grid => [grid, grid.innerHTML]);
      const [width, height] = [this.right - this.left, this.bottom - this.top];
      this.clip = `clip-${Math.random().toString(36).slice(2)}`;
      svg.insertAdjacentHTML("beforeend", `<clipPath id="${this.clip}"><rect x="${this.left}" y="${this.top}" width="${width}" height="${height}"/></clipPath>
        <rect class="selected" y="${this.top}" height="${height}" width="0"/>`);
      svg.insertAdjacentHTML("afterend", `<div class="cursor" hidden><div class="readout"></div></div>`);
      this.cursor = svg.nextElementSibling;
      this.size = svg.viewBox.baseVal;
      this.cursor.style.setProperty("--down", this.top / this.size.height);
      this.cursor.style.setProperty("--tall", height / this.size.height);
      svg.tabIndex = 0;
    }

    get curves() {
      this.read ||= [...this.svg.querySelectorAll(".curves path")].map(path => new Curve(path, this));
      return this.read;
    }

    /* Of a map: the pointer's place on the upright axis. */
    get high() {
      return viewOf(this).high ?? (this.range[0] + this.range[1]) / 2;
    }

    set high(high) {
      viewOf(this).high = high;
    }

    /* The place on the axis under a pointer. */
    under(event) {
      const box = this.svg.getBoundingClientRect();
      if (this.map) {
        const px = (event.clientY - box.top) / box.height * this.size.height;
        this.high = clamped(scaled(px, [this.bottom, this.top], ...this.range), this.range);
      }
      const px = (event.clientX - box.left) / box.width * this.size.width;
      return clamped(scaled(px, [this.left, this.right], ...this.shown), this.shown);
    }

    px(at, span = this.shown) {
      return scaled(at, span, this.left, this.right);
    }

    py(value, range = this.range) {
      return scaled(value, range, this.bottom, this.top);
    }

    /* Shows a span; null: all, as it was drawn at first. */
    show(span) {
      const x = this.shown = span || this.x;
      const y = this.range = !this.y || !span ? this.y : this.map ? this.square(x) : this.fitted(x);
      for (const [grid, whole] of this.grids) {
        grid.innerHTML = !span ? whole : grid.classList.contains("up") ? this.up() : this.across();
      }
      const data = this.svg.querySelector(".data");
      if (span) data.setAttribute("clip-path", `url(#${this.clip})`); else data.removeAttribute("clip-path");
      for (const moved of data.querySelectorAll("[data-at]")) this.move(moved);
      const curves = data.querySelector(".curves");
      if (!curves) return;
      const [wide, high] = [(this.x[1] - this.x[0]) / (x[1] - x[0]), (this.y[1] - this.y[0]) / (y[1] - y[0])];
      const [right, down] = [this.px(this.x[0]) - wide * this.left, this.py(this.y[0]) - high * this.bottom];
      curves.setAttribute("transform", `matrix(${wide / STEPS} 0 0 ${high / STEPS} ${right} ${down})`);
    }

    /* Of what is neither grid nor curve: marks keep their shape, stretches their ends. */
    move(element) {
      const at = Number(element.dataset.at);
      if (element.dataset.to) {
        element.setAttribute("x", this.px(at));
        element.setAttribute("width", Math.max(this.px(Number(element.dataset.to)) - this.px(at), 1.5));
      } else {
        const { up } = element.dataset;
        const down = up ? this.py(Number(up)) - this.py(Number(up), this.y) : 0;
        element.setAttribute("transform", `translate(${this.px(at) - this.px(at, this.x)} ${down})`);
      }
    }

    /* The vertical range of a map about the pointer's place. */
    square([from, to]) {
      const half = (to - from) * (this.bottom - this.top) / (this.right - this.left) / 2;
      return [this.high - half, this.high + half];
    }

    /* The vertical range of what is in a span. */
    fitted([from, to]) {
      let [low, high] = [Infinity, -Infinity];
      for (const curve of this.curves) {
        for (const value of [curve.value(from), ...curve.y.slice(curve.after(from), curve.after(to)), curve.value(to)]) {
          if (value === null) continue;
          low = Math.min(low, value);
          high = Math.max(high, value);
        }
      }
      if (low > high) return this.y;
      const least = Math.max(Number(this.svg.dataset.least), LOWEST * (this.y[1] - this.y[0]));
      const half = Math.max(high - low, least) / 2 * (1 + 2 * MARGIN);
      return [(low + high) / 2 - half, (low + high) / 2 + half];
    }

    across() {
      return ticks(this.shown, (this.right - this.left) / 62).map(([value, text]) => {
        const x = this.px(value).toFixed(1);
        return `<line class="grid" x1="${x}" y1="${this.top}" x2="${x}" y2="${this.bottom}"/>
          <text class="tick mid" x="${x}" y="${this.bottom + 14}">${text}</text>`;
      }).join("");
    }

    up() {
      return ticks(this.range, (this.bottom - this.top) / 30).map(([value, text]) => {
        const y = this.py(value);
        return `<line class="grid" x1="${this.left}" y1="${y}" x2="${this.right}" y2="${y}"/>
          <text class="tick end" x="${this.left - 5}" y="${y + 3.5}">${text}</text>`;
      }).join("");
    }

    /* Cursor and values at a place; null: none. */
    point(at) {
      const isSeen = at !== null && at === clamped(at, this.shown);
      this.cursor.hidden = !isSeen;
      if (!isSeen) return;
      this.cursor.style.setProperty("--right", this.px(at) / this.size.width);
      this.cursor.classList.toggle("before", this.px(at) > (this.left + this.right) / 2);
      const lines = this.values(at).map(([name, text, colour]) => {
        const line = document.createElement("div");
        line.textContent = `${name} `;
        if (colour) line.style.setProperty("--colour", `var(--${colour})`);
        line.append(Object.assign(document.createElement("b"), { textContent: text }));
        return line;
      });
      this.cursor.firstChild.replaceChildren(...lines);
    }

    /* What is to be read at a place: names, values with their units, colours. */
    values(at) {
      const [name, unit = ""] = this.axis.split(", ");
      const place = `${written(at, 4 - magnitude(this.x))} ${unit}`;
      if (this.map) {
        const [up, unit = ""] = this.map.split(", ");
        return [[name, place], [up, `${written(this.high, 4 - magnitude(this.y))} ${unit}`]];
      }
      const values = this.curves.map(curve => {
        const value = curve.value(at);
        return [curve.name, value === null ? "–" : `${written(value, 3 - magnitude(this.y))} ${this.svg.dataset.unit}`.trim(), curve.colour];
      });
      return [["at", place], ...values];
    }
  }

  const known = new WeakMap();
  /* By axis: the span that is shown (null: all), the cursor's place (null: none), of a map the height of both. */
  const views = {};
  const viewOf = chart => views[chart.axis] ||= { span: null, at: null };

  function chartOf(svg) {
    if (!known.has(svg)) known.set(svg, new Chart(svg));
    return known.get(svg);
  }

  const charts = () => [...document.querySelectorAll("svg[data-axis]")].map(chartOf);
  const linked = chart => charts().filter(each => each.axis === chart.axis);

  function chartAt(event) {
    const svg = event.target instanceof Element && event.target.closest("svg[data-axis]");
    return svg ? chartOf(svg) : null;
  }

  /* The whole axis of all charts that zoom together. */
  function whole(chart) {
    const all = linked(chart).map(each => each.x);
    return [Math.min(...all.map(each => each[0])), Math.max(...all.map(each => each[1]))];
  }

  function show(chart, span) {
    const all = whole(chart);
    if (span) {
      const half = Math.max(span[1] - span[0], NARROWEST * (all[1] - all[0])) / 2;
      const middle = (span[0] + span[1]) / 2;
      span = [clamped(middle - half, all), clamped(middle + half, all)];
      if (span[0] === all[0] && span[1] === all[1]) span = null;
    }
    const view = viewOf(chart);
    view.span = span;
    for (const each of linked(chart)) {
      each.show(span);
      each.point(view.at);
    }
    bar.hidden = Object.values(views).every(each => !each.span);
  }

  let next = null;
  /* Values are shown once a picture, however often the pointer moves. */
  function point(chart, at) {
    viewOf(chart).at = at;
    next ||= requestAnimationFrame(() => {
      next = null;
      for (const each of charts()) each.point(viewOf(each).at);
    });
  }

  function reset() {
    for (const each of charts()) if (viewOf(each).span) show(each, null);
  }

  let drag = null;
  let hovered = null;

  addEventListener("pointermove", event => {
    const chart = drag ? drag.chart : chartAt(event);
    if (hovered && hovered !== chart) point(hovered, null);
    hovered = chart;
    if (!chart) return;
    point(chart, chart.under(event));
    if (drag) select(drag, chart.under(event));
  });

  function select({ chart, from }, to) {
    const selected = chart.svg.querySelector(".selected");
    selected.setAttribute("x", chart.px(Math.min(from, to)));
    selected.setAttribute("width", Math.abs(chart.px(to) - chart.px(from)));
  }

  addEventListener("pointerdown", event => {
    const chart = event.button === 0 && event.isPrimary ? chartAt(event) : null;
    if (!chart || event.target.closest("a")) return;
    drag = { chart, from: chart.under(event), px: event.clientX, high: chart.map && chart.high };
    chart.svg.setPointerCapture(event.pointerId);
    point(chart, drag.from);
  });

  addEventListener("pointerup", event => {
    if (!drag) return;
    const { chart, from, px, high } = drag;
    select(drag, from);
    drag = null;
    const to = chart.under(event);
    if (chart.map) chart.high = (chart.high + high) / 2;
    if (Math.abs(event.clientX - px) >= LEAST_DRAG) show(chart, [Math.min(from, to), Math.max(from, to)]);
  });

  /* The page is scrolled by the finger. */
  addEventListener("pointercancel", () => {
    if (drag) select(drag, drag.from);
    drag = null;
  });

  addEventListener("dblclick", event => {
    if (chartAt(event)) reset();
  });

  /* Moves the cursor, and the span with it where it comes to its end. */
  function step(chart, at, by) {
    const to = clamped(at + by, viewOf(chart).span ? whole(chart) : chart.x);
    const [from, end] = chart.shown;
    if (to !== clamped(to, chart.shown)) show(chart, [from + by, end + by]);
    point(chart, clamped(to, chart.shown));
  }

  function magnify(chart, at, factor) {
    const [from, to] = chart.shown;
    show(chart, [at - (at - from) * factor, at + (to - at) * factor]);
    point(chart, at);
  }

  addEventListener("keydown", event => {
    const chart = chartAt(event);
    if (!chart || event.ctrlKey || event.altKey || event.metaKey) return;
    const [from, to] = chart.shown;
    const at = clamped(viewOf(chart).at ?? (from + to) / 2, chart.shown);
    const by = (to - from) * KEY_STEPS[Number(event.shiftKey)];
    const keys = {
      ArrowLeft: () => step(chart, at, -by),
      ArrowRight: () => step(chart, at, by),
      Home: () => point(chart, from),
      End: () => point(chart, to),
      "+": () => magnify(chart, at, 0.5),
      "=": () => magnify(chart, at, 0.5),
      "-": () => magnify(chart, at, 2),
      Escape: () => { reset(); point(chart, null); },
    };
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
    const seen = viewOf(chart).at;
    spoken.textContent = seen === null ? "" : chart.values(seen).map(([name, text]) => `${name} ${text}`).join(", ");
  });

  /* For pages that draw their charts anew. */
  addEventListener("redrawn", () => {
    for (const each of charts()) {
      each.show(viewOf(each).span);
      each.point(viewOf(each).at);
    }
  });

  document.body.insertAdjacentHTML("beforeend", `<p class="bar" hidden><button type="button">Show all</button></p><p class="spoken" role="status"></p>`);
  const [bar, spoken] = [...document.body.children].slice(-2);
  bar.firstChild.addEventListener("click", reset);
  document.documentElement.classList.add("zooms");
  charts();
})();
