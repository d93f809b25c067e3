"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const SVG = "http://www.w3.org/2000/svg";
const VIRIDIS = ["#440154", "#482878", "#3e4989", "#31688e", "#26828e", "#1f9e89", "#35b779", "#6ece58", "#b5de2b", "#fde725"].reverse();  // dark for much, as in pictures
const colour = (i) => `var(--c${i % 9})`;
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const byId = (id) => document.getElementById(id);

function shade(share) {
  const place = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1), low = Math.min(Math.floor(place), VIRIDIS.length - 2);
  const at = (i, k) => parseInt(VIRIDIS[i].slice(1 + 2 * k, 3 + 2 * k), 16);
  const mix = (k) => Math.round(at(low, k) + (at(low + 1, k) - at(low, k)) * (place - low));
  return [mix(0), mix(1), mix(2)];
}

const raised = (n) => String(n).replace(/./g, (c) => "⁰¹²³⁴⁵⁶⁷⁸⁹⁻"["0123456789-".indexOf(c)]);
function shown(value, digits = 4) {
  if (value === 0) return "0";
  const power = Math.floor(Math.log10(Math.abs(value)) + 1e-9);
  if (power >= -3 && power < 5) return String(Number(value.toPrecision(digits))).replace("-", "−");
  const front = Number((value / 10 ** power).toPrecision(digits));
  return (front === 1 ? "" : `${front}×`.replace("-", "−")) + `10${raised(power)}`;
}

const unitOf = (label) => (label.match(/\[(.*)\]$/) || ["", ""])[1];

function ticks(low, high, most, log) {
  if (log) {
    const first = Math.floor(low), last = Math.ceil(high), every = Math.max(1, Math.ceil((last - first) / most)), found = [];
    for (let p = first; p <= last; p += 1)
      for (const m of high - low < 1.2 ? [1, 2, 3, 4, 6, 8] : last - first < 4 ? [1, 2, 5] : [1]) {
        const at = p + Math.log10(m);
        if (at >= low - 1e-9 && at <= high + 1e-9 && (p - first) % every === 0) found.push(at);
      }
    return found;
  }
  const rough = (high - low) / Math.max(most, 1), power = 10 ** Math.floor(Math.log10(rough));
  const steps = [0.5, 1, 2, 5, 10].map((m) => m * power), fits = steps.findIndex((s) => s >= rough * 0.999);
  let found = [];
  for (let i = fits; i >= Math.max(0, fits - 2) && found.length < 3; i -= 1) {
    found = [];
    for (let n = Math.ceil(low / steps[i] - 1e-6); n * steps[i] <= high + 1e-6 * steps[i]; n += 1) found.push(n * steps[i]);
  }
  return found;
}

function add(parent, name, about, text) {
  const made = document.createElementNS(SVG, name);
  for (const key in about) made.setAttribute(key, about[key]);
  if (text !== undefined) made.textContent = text;
  parent.append(made);
  return made;
}

function limits(lists, log) {
  let low = Infinity, high = -Infinity;
  for (const list of lists) for (const v of list) if (v !== null && isFinite(v)) { if (v < low) low = v; if (v > high) high = v; }
  if (low > high) return [0, 1];
  const least = log ? 0.15 : Math.max(Math.abs(high), Math.abs(low), 1e-300) * 1e-6;
  if (high - low < least) { const half = log ? 0.5 : high === 0 ? 1 : Math.abs(high) * 0.05; return [low - half, high + half]; }
  return [low, high];
}

function draw(figure, chart) {
  const box = figure.querySelector("div"), width = box.clientWidth;
  if (!width) return;
  const scaled = chart.series.map((s) => {
    const points = s.x.map((x, i) => [chart.logX ? Math.log10(x) : x, chart.logY ? Math.log10(s.y[i]) : s.y[i]]);
    return { ...s, points: points.filter((p) => p.every((v) => v !== null && isFinite(v))) };
  });
  const height = Math.round(Math.min(340, Math.max(230, width * 0.42)));
  let [x0, x1] = limits([...scaled.map((s) => s.points.map((p) => p[0])), chart.span || []], chart.logX);
  let [y0, y1] = limits(scaled.map((s) => s.points.map((p) => p[1])), chart.logY);
  const dotted = scaled.some((s) => s.look === "dots");
  if (dotted && !chart.span) { const pad = (x1 - x0) * 0.03; x0 -= chart.logX || x0 - pad < 0 && x0 >= 0 ? Math.min(pad, x0 < 0 ? pad : x0) : pad; x1 += pad; }
  const pad = (y1 - y0) * 0.05;
  y0 = y0 >= 0 && y0 < 0.4 * y1 && !chart.logY ? 0 : y0 - pad;
  y1 += pad;
  const yTicks = ticks(y0, y1, Math.round(height / 55), chart.logY), label = (v, log) => (log && y1 - y0 > 4 ? `10${raised(Math.round(v))}` : shown(log ? Number((10 ** v).toPrecision(6)) : Number(v.toPrecision(9))));
  const yTexts = yTicks.map((v) => label(v, chart.logY)), left = 14 + 7.2 * Math.max(...yTexts.map((t) => t.length), 1);
  const right = 14, top = 24, bottom = 40;
  const px = (x) => left + ((x - x0) / (x1 - x0)) * (width - left - right), py = (y) => height - bottom - ((y - y0) / (y1 - y0)) * (height - top - bottom);
  const svg = document.createElementNS(SVG, "svg");
  for (const [key, value] of Object.entries({ viewBox: `0 0 ${width} ${height}`, height, role: "img", "aria-label": chart.title || "" })) svg.setAttribute(key, value);
  yTicks.forEach((v, i) => {
    add(svg, "line", { x1: left, x2: width - right, y1: py(v), y2: py(v), class: "grid" });
    add(svg, "text", { x: left - 6, y: py(v) + 4, "text-anchor": "end" }, yTexts[i]);
  });
  const xTicks = ticks(x0, x1, Math.round(width / 90), chart.logX);
  for (const v of xTicks) {
    add(svg, "line", { x1: px(v), x2: px(v), y1: height - bottom, y2: height - bottom + 4, class: "axis" });
    add(svg, "text", { x: px(v), y: height - bottom + 17, "text-anchor": "middle" }, label(v, chart.logX));
  }
  add(svg, "line", { x1: left, x2: width - right, y1: height - bottom, y2: height - bottom, class: "axis" });
  add(svg, "text", { x: 0, y: 12 }, chart.title && chart.y.toLowerCase().startsWith(`${chart.title.toLowerCase()} [`) ? unitOf(chart.y) : chart.y);
  add(svg, "text", { x: width - right, y: height - 4, "text-anchor": "end" }, chart.x);
  const legend = document.createElement("div");
  legend.className = "legend";
  scaled.forEach((s, i) => {
    const ink = colour(i);
    if (s.look === "dots") for (const p of s.points) add(svg, "circle", { cx: px(p[0]).toFixed(1), cy: py(p[1]).toFixed(1), r: s.points.length > 300 ? 2 : 3.5, fill: ink, "fill-opacity": 0.75, class: "mark" });
    else {
      const path = s.points.map((p, k) => `${k ? "L" : "M"}${px(p[0]).toFixed(1)} ${py(p[1]).toFixed(1)}`).join("");
      add(svg, "path", { d: path, fill: "none", stroke: ink, "stroke-width": 1.7, "stroke-linejoin": "round", "stroke-dasharray": s.look === "dash" ? "6 4" : "none", class: "mark" });
      if (s.points.length === 1) add(svg, "circle", { cx: px(s.points[0][0]), cy: py(s.points[0][1]), r: 3.5, fill: ink, class: "mark" });
    }
    const entry = document.createElement("span"), line = document.createElement("i"), name = document.createElement("span");
    entry.style.color = ink; line.className = s.look; name.textContent = s.name; entry.append(line, name); legend.append(entry);
  });
  box.replaceChildren(...(scaled.length > 1 || !dotted ? [legend, svg] : [svg]));
}

function unpack(text, low = 0, high = 1) {
  const raw = atob(text), found = new Float64Array(raw.length / 2);
  for (let i = 0; i < found.length; i += 1) {
    const whole = raw.charCodeAt(2 * i) + 256 * raw.charCodeAt(2 * i + 1);
    found[i] = whole === 65535 ? NaN : low + (whole / 65534) * (high - low);
  }
  return found;
}

function paint(canvas, height) {
  const width = canvas.clientWidth, ratio = Math.min(window.devicePixelRatio || 1, 3), pen = canvas.getContext("2d");
  canvas.style.height = `${height}px`; canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio);
  pen.setTransform(ratio, 0, 0, ratio, 0, 0); pen.clearRect(0, 0, width, height);
  return pen;
}

function bar(box, field, label = field.label) {
  const row = document.createElement("div"), low = document.createElement("span"), high = document.createElement("span"), strip = document.createElement("canvas");
  row.className = "bar"; low.textContent = shown(field.low, 3); high.textContent = `${shown(field.high, 3)} ${label}`;
  row.append(low, strip, high); box.replaceChildren(row);
  strip.width = 160; strip.height = 1;
  const pen = strip.getContext("2d");
  for (let i = 0; i < 160; i += 1) { pen.fillStyle = `rgb(${shade(i / 159)})`; pen.fillRect(i, 0, 1, 1); }
}

const map = data.map;
if (map) {
  map.lines = unpack(map.edges);
  if (map.times) {
    map.at = unpack(map.points);
    const xs = [...map.at.filter((_, i) => i % 2 === 0), ...map.wells.map((w) => w[1])], ys = [...map.at.filter((_, i) => i % 2), ...map.wells.map((w) => w[2])];
    const [x0, x1] = limits([xs], false), [y0, y1] = limits([ys], false), room = 0.12 * Math.max(x1 - x0, y1 - y0);
    const focus = [Math.max(0, x0 - room), Math.max(0, y0 - room), Math.min(map.extent[0], x1 + room), Math.min(map.extent[1], y1 + room)];
    focus[2] -= focus[0]; focus[3] -= focus[1];
    if (focus[2] * focus[3] < 0.7 * map.extent[0] * map.extent[1]) map.focus = focus;
    byId("whole-rock").hidden = !map.focus;
    for (const field of Object.values(map.fields)) field.shares = unpack(field.values);
  }
}
const time = (k) => (map.times[k] === null ? "" : `${shown(map.times[k], 6)} ${map.clock}`.trim());

function drawMap() {
  const canvas = document.querySelector("#chart-map canvas"), width = canvas.clientWidth;
  if (!width) return;
  const [ox, oy, wide, high] = map.focus && !byId("whole").checked ? map.focus : [0, 0, ...map.extent], pad = 22;
  const scale = Math.min((width - 2 * pad) / Math.max(wide, 1e-9), Math.max(260, Math.min(620, window.innerHeight * 0.75)) / Math.max(high, 0.05));
  const height = Math.round(high * scale + 2 * pad), pen = paint(canvas, height), shift = (width - wide * scale) / 2;
  const x = (v) => shift + (v - ox) * scale, y = (v) => height - pad - (v - oy) * scale;
  map.view = { x, y };
  pen.strokeStyle = css("--line"); pen.lineWidth = 0.6; pen.beginPath();
  for (let i = 0; i < map.lines.length; i += 4) { pen.moveTo(x(map.lines[i]), y(map.lines[i + 1])); pen.lineTo(x(map.lines[i + 2]), y(map.lines[i + 3])); }
  pen.stroke(); pen.lineCap = "round";
  const taken = [];
  if (map.times) {
    const k = Number(byId("slider").value), field = map.fields[byId("quantity").value], count = map.at.length / 2;
    const now = map.times[k], before = k ? map.times[k - 1] : -Infinity, slips = map.slips.filter((s) => s[2] <= now && (s[3] === null || s[3] > before));
    pen.strokeStyle = "#ff7f0e"; pen.fillStyle = "#ff7f0e"; pen.globalAlpha = 0.55;
    for (const [sx, sy] of slips) { pen.beginPath(); pen.arc(x(sx), y(sy), 6.5, 0, 7); pen.fill(); }
    pen.globalAlpha = 1;
    for (const [, from, to] of map.fractures)
      for (let i = from; i + 1 < to; i += 1) {
        const share = field ? (field.shares[k * count + i] + field.shares[k * count + i + 1]) / 2 : NaN;
        for (const [thick, ink] of [[5.5, css("--ink")], [4, isNaN(share) ? css("--pale") : `rgb(${shade(share)})`]]) {
          pen.strokeStyle = ink; pen.lineWidth = thick; pen.beginPath();
          pen.moveTo(x(map.at[2 * i]), y(map.at[2 * i + 1])); pen.lineTo(x(map.at[2 * i + 2]), y(map.at[2 * i + 3])); pen.stroke();
        }
      }
    const events = map.events.filter((e) => e[2] <= now);
    pen.lineWidth = 1.5;
    for (const [ex, ey, began, size] of events) {
      pen.strokeStyle = began > before ? "#d62728" : css("--ink"); pen.beginPath();
      pen.arc(x(ex), y(ey), size === null ? 5 : Math.min(26, Math.max(4, 5 * 1.6 ** (size - 1))), 0, 7); pen.stroke();
    }
    byId("now").textContent = time(k);
    byId("under").textContent = `State ${map.steps[k]}, ${time(k)}: ${slips.length} sections slip, ${events.length} event${events.length === 1 ? "" : "s"} so far.`;
  }
  pen.strokeStyle = css("--ink"); pen.lineWidth = 1.2; pen.font = "12px system-ui, sans-serif"; pen.textBaseline = "middle";
  for (const [, px, py] of map.probes) { pen.fillStyle = css("--back"); pen.beginPath(); pen.arc(x(px), y(py), 3, 0, 7); pen.fill(); pen.stroke(); }
  for (const [, px, py] of map.wells) {
    pen.fillStyle = "#56b4e9"; pen.beginPath(); pen.moveTo(x(px) - 6, y(py) - 10); pen.lineTo(x(px) + 6, y(py) - 10); pen.lineTo(x(px), y(py)); pen.closePath(); pen.fill(); pen.stroke();
    taken.push([x(px) - 7, y(py) - 11, x(px) + 7, y(py)]);
  }
  if (map.limit.length) {
    const [px, py] = [x(map.limit[0]), y(map.limit[1])];
    pen.fillStyle = "#cc79a7"; pen.beginPath(); pen.moveTo(px, py - 7); pen.lineTo(px + 7, py); pen.lineTo(px, py + 7); pen.lineTo(px - 7, py); pen.closePath(); pen.fill(); pen.stroke();
  }
  const traces = [];
  for (let i = 0; map.at && i < map.at.length; i += 2) traces.push([x(map.at[i]) - 3, y(map.at[i + 1]) - 3, x(map.at[i]) + 3, y(map.at[i + 1]) + 3]);
  const hits = (box) => (t) => t[0] < box[2] && box[0] < t[2] && t[1] < box[3] && box[1] < t[3];
  const name = (text, places) => {
    const short = text.length > 28 ? `${text.slice(0, 27)}…` : text, half = pen.measureText(short).width / 2 + 2;
    // beside the traces where there is room, else over them
    for (const [[cx, cy], isFree] of [...places.map((p) => [p, true]), ...places.map((p) => [p, false])]) {
      const box = [cx - half, cy - 8, cx + half, cy + 8];
      if (box[0] < 0 || box[2] > width || box[1] < 0 || box[3] > height) continue;
      if (taken.some(hits(box)) || (isFree && traces.some(hits(box)))) continue;
      taken.push(box); pen.textAlign = "center"; pen.lineWidth = 3.5; pen.strokeStyle = css("--back"); pen.strokeText(short, cx, cy); pen.fillStyle = css("--ink"); pen.fillText(short, cx, cy);
      return true;
    }
    return false;
  };
  for (const [text, px, py] of map.wells) { const w = pen.measureText(text).width / 2 + 12; name(text, [[x(px) + w, y(py) - 6], [x(px) - w, y(py) - 6], [x(px), y(py) - 22], [x(px), y(py) + 12]]); }
  let left = 0;
  for (const [text, from, to] of map.fractures || []) {
    const places = [], half = pen.measureText(text).width / 2;
    for (const part of [0.5, 0.25, 0.75, 0.05, 0.95]) {
      const i = Math.min(to - 2, from + Math.floor((to - from - 1) * part)), ax = x(map.at[2 * i]), ay = y(map.at[2 * i + 1]);
      const dx = x(map.at[2 * i + 2]) - ax, dy = y(map.at[2 * i + 3]) - ay, long = Math.hypot(dx, dy) || 1, off = 13 + Math.abs(dy / long) * half;
      for (const side of [1, -1]) places.push([ax + (side * dy / long) * off, ay - (side * dx / long) * off]);
    }
    left += name(text, places) ? 0 : 1;
  }
  if (left && byId("under")) byId("under").textContent += ` ${left} names have no room; touch a fracture for its name.`;
}

function drawProfile() {
  const figure = byId("profile");
  if (!figure) return;
  const key = byId("quantity").value, field = map.fields[key], [name, from, to] = map.fractures[byId("fracture").value], count = map.at.length / 2;
  const of = (k) => Array.from(field.shares.slice(k * count + from, k * count + to), (s) => (isNaN(s) ? null : field.low + s * (field.high - field.low)));
  const k = Number(byId("slider").value), x = map.along.slice(from, to);
  const series = [{ name: `${name}, ${time(k)}`, look: "line", x, y: of(k) }, { name: time(0), look: "dash", x, y: of(0) }];
  draw(figure, { title: name, x: map.unit ? `distance [${map.unit}]` : "distance", y: field.label, series });
}

function drawHeat(figure) {
  const canvas = figure.querySelector("canvas");
  if (!canvas.clientWidth || (figure.checkVisibility && !figure.checkVisibility())) return;
  const field = map.fields[figure.dataset.field], [, from, to] = map.fractures[figure.dataset.fracture], count = map.at.length / 2;
  const times = map.times, last = times.length - 1, moves = times[last] > times[0], pen = paint(canvas, 128), width = canvas.clientWidth, high = 104, left = 34;
  const far = map.along[to - 1] || 1, ratio = canvas.width / width, w = Math.max(1, Math.round((width - left - 2) * ratio)), h = Math.round(high * ratio);
  const image = pen.createImageData(w, h);
  for (let a = 0, k = 0; a < w; a += 1) {
    const now = (a + 0.5) / w;
    while (k < last && (moves ? (times[k + 1] - times[0]) / (times[last] - times[0]) : (k + 1) / (last + 1)) <= now) k += 1;
    for (let b = 0, i = from; b < h; b += 1) {
      const s = ((b + 0.5) / h) * far;
      while (i < to - 2 && map.along[i + 1] < s) i += 1;
      const part = (s - map.along[i]) / (map.along[i + 1] - map.along[i] || 1), one = field.shares[k * count + i];
      const share = one + (field.shares[k * count + i + 1] - one) * part;
      if (!isNaN(share)) image.data.set([...shade(share), 255], 4 * ((h - 1 - b) * w + a));
    }
  }
  pen.putImageData(image, Math.round(left * ratio), 0);
  pen.fillStyle = css("--ink"); pen.font = "11px system-ui, sans-serif"; pen.textAlign = "right"; pen.textBaseline = "top";
  pen.fillText(shown(far, 3), left - 4, 0); pen.textBaseline = "bottom"; pen.fillText(`0 ${map.unit}`, left - 4, high);
  pen.textBaseline = "top"; pen.textAlign = "left"; pen.fillText(moves ? shown(times[0], 3) : "first state", left, high + 5);
  pen.textAlign = "right"; pen.fillText(moves ? `${shown(times[last], 4)} ${map.clock}` : "last state", width - 2, high + 5);
}

function drawAll() {
  for (const figure of document.querySelectorAll(".chart[data-chart]")) draw(figure, data.charts[figure.dataset.chart]);
  if (!map) return;
  drawMap();
  if (!map.times) return;
  drawProfile();
  for (const box of document.querySelectorAll(".scale[data-field]")) bar(box, map.fields[box.dataset.field], unitOf(map.fields[box.dataset.field].label));
  document.querySelectorAll(".heat").forEach(drawHeat);
}

function drawState() {
  const field = map.fields[byId("quantity").value];
  if (field) bar(byId("scale"), field);
  drawMap();
  drawProfile();
}

if (map && map.times) {
  const slider = byId("slider"), play = byId("play");
  for (const id of ["slider", "quantity", "fracture", "whole"]) byId(id).addEventListener("input", drawState);
  let timer = null;
  play.addEventListener("click", () => {
    if (timer) { clearInterval(timer); timer = null; play.textContent = "play"; return; }
    if (slider.value === slider.max) slider.value = 0;
    play.textContent = "stop";
    timer = setInterval(() => {
      slider.value = Number(slider.value) + 1; drawState();
      if (slider.value === slider.max) { clearInterval(timer); timer = null; play.textContent = "play"; }
    }, 100);
  });
  document.querySelector("#chart-map canvas").addEventListener("pointermove", (event) => {
    const box = event.target.getBoundingClientRect(), mx = event.clientX - box.left, my = event.clientY - box.top;
    let best = 14, found = "";
    const k = Number(slider.value), field = map.fields[byId("quantity").value], count = map.at.length / 2;
    for (const [name, from, to] of map.fractures)
      for (let i = from; i < to; i += 1) {
        const away = Math.hypot(map.view.x(map.at[2 * i]) - mx, map.view.y(map.at[2 * i + 1]) - my);
        if (away < best) {
          best = away;
          const share = field ? field.shares[k * count + i] : NaN;
          found = `${name}, ${shown(map.along[i], 3)} ${map.unit} from its start` + (isNaN(share) ? "" : `: ${field.label} ${shown(field.low + share * (field.high - field.low), 4)}`);
        }
      }
    if (found) byId("under").textContent = found;
  });
  drawState();
}
for (const more of document.querySelectorAll("details")) more.addEventListener("toggle", () => { more.querySelectorAll(".heat").forEach(drawHeat); });
if (window.innerWidth <= 760) document.querySelector("nav details").open = false;
let waiting = null, drawn = window.innerWidth;
window.addEventListener("resize", () => {
  if (window.innerWidth === drawn) return;
  drawn = window.innerWidth; clearTimeout(waiting); waiting = setTimeout(drawAll, 100);
});
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
drawAll();
