"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const float = (text) => new Float32Array(bytes(text));
const times = new Float64Array(bytes(data.times));
const mode = new Int32Array(bytes(data.mode));
for (const region of data.regions) region.state = new Uint8Array(bytes(region.state));
const last = times.length - 1;
const made = (parent, tag, attributes = {}, text = null) => {
  const svg = parent.namespaceURI === "http://www.w3.org/2000/svg" || tag === "svg";
  const node = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  if (text !== null) node.textContent = text;
  return parent.appendChild(node);
};
const short = (x) => String(Number(x.toPrecision(7)));
const level = (x, digits = 3) => {
  const plain = String(Number(x.toPrecision(digits)));
  return plain.length < 9 ? plain : x.toExponential(digits - 1).replace(/\.?0+e/, "e");
};

// The largest of 1, 2, 5 times a power of ten that is no more.
const round = (x) => {
  const power = 10 ** Math.floor(Math.log10(x));
  return [5, 2, 1].map((s) => s * power).find((s) => s <= x * (1 + 1e-9));
};
// Round numbers between two, with at most so many steps between them.
function ticks(low, high, most) {
  const power = 10 ** Math.floor(Math.log10((high - low) / most || 1));
  const ends = (step) => [Math.ceil(low / step - 1e-9), Math.floor(high / step * (1 + 1e-12) + 1e-9)];
  const step = [1, 2, 5, 10].map((s) => s * power).find((s) => ends(s)[1] - ends(s)[0] <= most);
  const [first, last] = ends(step);
  return Array.from({ length: last - first + 1 }, (_, k) => (first + k) * step);
}

// The scene: y is up, so every place is written with its y turned round.
const film = data.film;
const moving = [];
function placed(point, frame, k) {
  const at = 3 * (k * film.frames + frame);
  const [x, y, angle] = [film.poses[at], film.poses[at + 1], film.poses[at + 2]];
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return [x + c * point[0] - s * point[1], y + s * point[0] + c * point[1]];
}
const path = (points, closed = false) =>
  points.map((p, i) => `${i ? "L" : "M"}${p[0]} ${-p[1]}`).join("") + (closed ? "Z" : "");
function shaped(scene, shape, behind) {
  const linked = ["link", "rope", "spring", "damper", "reaction"].includes(shape.kind);
  const group = made(linked ? behind : scene, "g", { "data-name": shape.name, "data-kind": shape.kind });
  const unit = film.unit;
  if (shape.kind === "coupling") {
    const region = data.regions[shape.region];
    const line = made(behind, "path", { class: "link reaction" });
    const mark = made(group, "path", { class: "mark", "data-coupling": shape.name });
    const r = 0.01 * unit;
    moving.push((k) => {
      const [a, b] = [placed(shape.points[0], shape.frame, k), placed(shape.points.at(-1), shape.other, k)];
      const [x, y] = [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
      line.setAttribute("d", path([a, b]));
      mark.setAttribute("d", path([[x - r, y], [x, y - r], [x + r, y], [x, y + r]], true));
      mark.setAttribute("data-state", region.states[region.state[k]]);
      mark.style.fill = region.colours[region.state[k]];
    });
    return;
  }
  if (linked) {
    const line = made(group, "path", { class: `link ${shape.kind}` });
    moving.push((k) => {
      const [a, b] = [placed(shape.points[0], shape.frame, k), placed(shape.points.at(-1), shape.other, k)];
      line.setAttribute("d", between(a, b, shape));
      if (shape.slack) line.classList.toggle("slack", shape.slack[k]);
    });
    return;
  }
  if (shape.kind === "ground") {
    made(group, "path", { class: "ground", d: path(shape.points) });
    const marks = shape.strokes.map((s) => path([[s[0], s[1]], [s[2], s[3]]])).join("");
    made(group, "path", { class: "hatch", d: marks });
  } else if (shape.kind === "outline") {
    made(group, "path", { class: "filled", d: path(shape.points, true) });
  } else if (shape.kind === "disc") {
    const [x, y] = shape.points[0];
    made(group, "circle", { class: "filled", cx: x, cy: -y, r: shape.radius });
    if (shape.turns) made(group, "path", { class: "link", d: path([[x, y], [x + shape.radius, y]]) });
  } else if (shape.kind === "bar") {
    const d = path(shape.points);
    const around = made(group, "path", { d, "stroke-linecap": "round", style: "stroke: var(--frame); fill: none" });
    const inside = made(group, "path", { d, "stroke-linecap": "round", style: "stroke: var(--body); fill: none" });
    around.setAttribute("stroke-width", 10);
    inside.setAttribute("stroke-width", 7.5);
  } else {
    const r = (shape.kind === "mass" ? 0.011 : 0.007) * unit;
    const [x, y] = shape.points[0];
    const held = shape.kind === "pivot" ? " held" : "";
    const mass = shape.kind === "mass" ? "filled" : "mark" + held;
    if (held) made(group, "rect", { class: mass, x: x - r, y: -y - r, width: 2 * r, height: 2 * r });
    else made(group, "circle", { class: mass, cx: x, cy: -y, r });
  }
  if (shape.frame > 0) moving.push((k) => {
    const at = 3 * (k * film.frames + shape.frame);
    const turn = (-film.poses[at + 2] * 180) / Math.PI;
    group.setAttribute("transform", `translate(${film.poses[at]} ${-film.poses[at + 1]}) rotate(${turn})`);
  });
  if (shape.region >= 0) moving.push((k) => {
    const region = data.regions[shape.region];
    group.firstChild.style.fill = region.colours[region.state[k]];
  });
}
// Lines of springs and dampers: how far along and, in half widths of a spring, across.
const zigzag = Array.from({ length: 15 }, (_, i) => [0.2 + (0.6 * i) / 14, i % 14 ? (i % 2 ? -1 : 1) : 0]);
const profiles = {
  spring: [[[0, 0], ...zigzag, [1, 0]]],
  damper: [[[0, 0], [0.55, 0], [0.55, 0.3], [0.55, -0.3]], [[0.4, 0.45], [0.7, 0.45], [0.7, -0.45], [0.4, -0.45]], [[0.7, 0], [1, 0]]],
};
function between(a, b, { kind, aside }) {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const side = (0.018 * film.unit) / (Math.hypot(dx, dy) || 1);
  const at = ([s, w]) => [a[0] + s * dx - w * side * dy, a[1] + s * dy + w * side * dx];
  let parts = profiles[kind] || [[[0, 0], [1, 0]]];
  if (aside && profiles[kind]) {
    parts = parts.map((part) => part.map(([s, w]) => [0.12 + 0.76 * s, w + aside]));
    parts[0].unshift([0, 0], [0.12, 0]);
    parts.at(-1).push([0.88, 0], [1, 0]);
  }
  return parts.map((part) => path(part.map(at))).join("");
}
function touching(scene, touch) {
  const region = data.regions[touch.region];
  const cone = made(scene, "path", { class: "cone" });
  const shaft = made(scene, "path", { class: "force" });
  const head = made(scene, "path", { class: "head" });
  const mark = made(scene, "circle", { class: "mark", "data-contact": touch.name });
  moving.push((k) => {
    const [x, y] = [touch.places[2 * k], touch.places[2 * k + 1]];
    const state = region.states[region.state[k]];
    const closed = state !== "free" && state !== "off";
    mark.setAttribute("cx", x);
    mark.setAttribute("cy", -y);
    mark.setAttribute("r", (closed ? 0.008 : 0.005) * film.unit);
    mark.setAttribute("data-state", state);
    mark.style.display = state === "off" ? "none" : "";
    mark.style.fill = closed ? region.colours[region.state[k]] : "";
    let [fx, fy] = [touch.forces[2 * k] * film.arrow, touch.forces[2 * k + 1] * film.arrow];
    const most = film.arrow * film.longest;
    const size = Math.hypot(fx, fy);
    if (size > most) [fx, fy] = [(fx * most) / size, (fy * most) / size];
    const long = Math.min(size, most);
    const tip = Math.min(0.02 * film.unit, long);
    const [ux, uy] = size > 0 ? [fx / long, fy / long] : [0, 0];
    const [bx, by] = [x + fx - tip * ux, y + fy - tip * uy];
    shaft.setAttribute("d", size > 0 ? path([[x, y], [bx, by]]) : "");
    const side = 0.4 * tip;
    head.setAttribute("d", size > 0 ? path([[x + fx, y + fy], [bx - side * uy, by + side * ux], [bx + side * uy, by - side * ux]], true) : "");
    const [nx, ny, friction] = [touch.normals[2 * k], touch.normals[2 * k + 1], touch.friction[k]];
    if (!closed || !(friction > 0)) return cone.setAttribute("d", "");
    const half = Math.atan(friction);
    const rim = [[x, y]];
    for (let i = -6; i <= 6; i++) {
      const [c, s] = [Math.cos((half * i) / 6), Math.sin((half * i) / 6)];
      const reach = film.arrow * film.usual;
      rim.push([x + reach * (c * nx - s * ny), y + reach * (s * nx + c * ny)]);
    }
    cone.setAttribute("d", path(rim, true));
  });
}
if (film) {
  for (const name of ["poses", "centres"]) film[name] = float(film[name]);
  for (const touch of film.touches)
    for (const name of ["places", "normals", "forces", "friction"]) touch[name] = float(touch[name]);
  const scene = byId("scene");
  const [w, h] = film.half;
  scene.style.aspectRatio = w / h;
  moving.push((k) =>
    scene.setAttribute("viewBox", `${film.centres[2 * k] - w} ${-film.centres[2 * k + 1] - h} ${2 * w} ${2 * h}`));
  for (const shape of film.shapes) if (shape.kind === "ground") shaped(scene, shape);
  for (const frame of film.trails) {
    const trail = made(scene, "path", { class: "trail" });
    const points = Array.from(times, (_, k) => placed([0, 0], frame, k));
    moving.push((k) => trail.setAttribute("d", path(points.slice(0, k + 1))));
  }
  const behind = made(scene, "g", {});
  for (const shape of film.shapes) if (shape.kind !== "ground") shaped(scene, shape, behind);
  for (const touch of film.touches) touching(scene, touch);
  // A bar of a round length, in the lower left corner.
  const real = film.length / film.unit;
  const length = round(0.25 * 2 * w * real);
  const scale = made(scene, "g", { id: "scale" });
  const [long, edge] = [length / real, 0.03 * 2 * h];
  made(scale, "path", { class: "bar-scale", d: `M0 -8V8M0 0H${long}M${long} -8V8` });
  made(scale, "text", { y: -14 }, `${level(length)} ${film.of}`.trim());
  moving.push((k) => scale.setAttribute("transform",
    `translate(${film.centres[2 * k] - w + 20} ${-film.centres[2 * k + 1] + h - edge - 8})`));
} else byId("scene").remove();

