"use strict";
// Regions: the masks of the recipe as a list, as shapes with handles in the view, and as paint.
// Uses the camera (`view`), the state and the pictures of studio.js.

const FIELD = 30; // vertical field of view of the perspective camera, in degrees
const HANDLE = 6, GRASP = 11; // radius of a handle in pixels, and distance from which it is grasped
const PAINTED_ROWS = 1024; // edge of a painting in pixels
const MASK_COLOUR = "#ff5c42";

/* ---- geometry: scene, cells around the grid's centre, pixels --------------------------------------------------- */

const plus = (a, b, by = 1) => a.map((value, index) => value + by * b[index]);
const times = (a, by) => a.map((value) => value * by);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

function cameraAxes() {
  const a = view.azimuth * Math.PI / 180, e = view.elevation * Math.PI / 180;
  const right = [Math.cos(a), 0, -Math.sin(a)];
  const up = [-Math.sin(a) * Math.sin(e), Math.cos(e), -Math.cos(a) * Math.sin(e)];
  return { right, up, towards: [Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e)] };
}

const pixelsPerCell = () => canvas.clientHeight / view.height;

// How much larger than at the distance of the centre a point is seen; 0 behind the eye.
function enlarged(point) {
  if (!$("perspective").checked) return 1;
  const distance = view.height / 2 / Math.tan(FIELD / 2 * Math.PI / 180), depth = distance - dot(point, cameraAxes().towards);
  return depth > 0.02 * distance ? distance / depth : 0;
}

// Where a point, in cells around the grid's centre, is seen; null behind the eye.
function projected(point) {
  const { right, up } = cameraAxes(), factor = enlarged(point) * pixelsPerCell();
  if (!factor) return null;
  return [
    canvas.clientWidth / 2 + factor * (dot(point, right) - view.right),
    canvas.clientHeight / 2 - factor * (dot(point, up) - view.up),
  ];
}

// How far a point moves in parallel to the picture, if what is seen of it moves by pixels.
function movedInPicture(point, x, y) {
  const { right, up } = cameraAxes(), factor = 1 / (enlarged(point) * pixelsPerCell());
  return plus(times(right, x * factor), up, -y * factor);
}

// How far along a direction a point moves, if what is seen of it follows the pointer as well as it can.
function movedAlong(point, direction, x, y) {
  const from = projected(point), to = projected(plus(point, direction));
  if (!from || !to) return 0;
  const seen = [to[0] - from[0], to[1] - from[1]], square = seen[0] ** 2 + seen[1] ** 2;
  return square > 1e-9 ? (seen[0] * x + seen[1] * y) / square : 0;
}

let place = null, placeOf = ""; // of the shown frame in the scene

async function askPlace() {
  if (!state || !state.opened) return;
  const key = `${JSON.stringify([state.opened.path, state.opened.names, state.opened.shape])} ${$("frame").value}`;
  if (key === placeOf) return;
  placeOf = key;
  try {
    const answer = await got(`place?${new URLSearchParams({ frame: $("frame").value })}`);
    if (key !== placeOf) return; // another frame is shown by now
    place = answer;
    drawGizmos();
  } catch (error) {
    placeOf = "";
    complain(error.message);
  }
}

// The edge of a cell in the scene; cells are cubes that lie along its axes.
const cellEdge = () => Math.hypot(...place.to_scene.map((row) => row[0]));

const gridCentre = () => { const [d, h, w] = state.opened.shape; return [(w - 1) / 2, (h - 1) / 2, (d - 1) / 2]; };

function toScene(point) {
  const cell = plus(point, gridCentre());
  return place.to_scene.map((row) => dot(row, cell) + row[3]);
}

function fromScene(point) {
  const square = cellEdge() ** 2, offset = place.to_scene.map((row, index) => point[index] - row[3]);
  const cell = [0, 1, 2].map((column) => dot(place.to_scene.map((row) => row[column]), offset) / square);
  return plus(cell, gridCentre(), -1);
}

const directionFromScene = (direction) => plus(fromScene(direction), fromScene([0, 0, 0]), -1);
const directionToScene = (direction) => plus(toScene(direction), toScene([0, 0, 0]), -1);

/* ---- the list ---------------------------------------------------------------------------------------------------- */

let asked = 0; // index of the part that is to have handles: a new one is not there yet
const targetIndex = () => Number($("masked").value) || 0;
const selected = () => Math.max(0, Math.min(asked, parts().length - 1));
const parts = () => (state && state.masks[targetIndex()] ? state.masks[targetIndex()].parts : []);
const keyed = (value) => value !== null && typeof value === "object" && !Array.isArray(value);
const frameIndex = () => Number($("frame").value);

function edit(action, part, values = {}) {
  return post("mask", { action, target: targetIndex(), part, values, frame: frameIndex() });
}

// Edits while something is dragged: one at a time, the latest next.
let editing = false, nextEdit = null;
async function editSoon(part, values) {
  nextEdit = [part, values];
  if (editing) return;
  editing = true;
  while (nextEdit) {
    const [index, latest] = nextEdit;
    nextEdit = null;
    await edit("change", index, latest);
  }
  editing = false;
}

const tidy = (value) => Number(value.toPrecision(5));
const inScene = (point) => point.map((value) => tidy(value));

function numbersRow(index, part, key) {
  const row = element("div", undefined, { className: "row" }), value = part.table[key] ?? (key === "strength" ? 1 : 0);
  row.append(element("span", key));
  if (keyed(value)) {
    row.append(element("span", "changes over the frames", { style: "grid-column: 2 / -1" }));
    return row;
  }
  const inputs = (Array.isArray(value) ? value : [value]).map((number, axis, all) => {
    const input = element("input", undefined, { type: "number", step: "any", value: tidy(number) });
    input.setAttribute("aria-label", all.length > 1 ? `${key} ${"xyz"[axis]}` : key);
    input.addEventListener("change", async () => {
      const numbers = inputs.map((other) => (other.value === "" ? null : Number(other.value)));
      const done = await edit("change", index, { [key]: all.length > 1 ? numbers : numbers[0] });
      if (!done) inputs.forEach((other, of) => { other.value = tidy(all[of]); });
    });
    return input;
  });
  if (key === "strength") Object.assign(inputs[0], { min: 0, max: 1, step: 0.05 });
  row.append(...inputs);
  return row;
}

function switchFor(index, key, text, on, title) {
  const label = element("label", undefined, { title }), box = element("input", undefined, { type: "checkbox", checked: on });
  box.dataset.key = key;
  box.addEventListener("change", () => edit("change", index, { [key]: box.checked || null }));
  label.append(box, text);
  return label;
}

function partRow(part, index) {
  const row = element("div", undefined, { className: index === selected() ? "part on" : "part" });
  row.dataset.form = part.form;
  const head = element("div", undefined, { className: "head" }), name = element("button", part.title);
  const remove = element("button", "×", { title: "remove" });
  name.addEventListener("click", () => { asked = index; showParts(); drawGizmos(); });
  remove.addEventListener("click", () => edit("remove", index));
  head.append(name, remove);
  row.append(head);
  if (index !== selected()) return row;
  const keys = { sphere: ["centre", "radius", "edge"], box: ["low", "high", "edge"] }[part.form] || [];
  row.append(...[...keys, "strength"].map((key) => numbersRow(index, part, key)));
  const follow = part.table.follow ?? false, switches = element("div", undefined, { className: "switches" });
  const follows = `follow${typeof follow === "number" ? ` from frame ${follow}` : ""}`;
  switches.append(switchFor(index, "invert", "invert", Boolean(part.table.invert), "Everywhere but there"));
  if (state.opened && state.opened.names.length > 1) {
    switches.append(switchFor(index, "follow", follows, follow !== false, "Moves with the smoke from the shown frame on, by its velocities"));
  }
  row.append(switches);
  return row;
}

let shownList = "";

function showParts() {
  if (!state) return;
  const chosen = Math.min(targetIndex(), state.masks.length - 1);
  alsoAsked.mask = $("masks-shown").checked && state.masks[chosen].parts.length ? chosen : "none";
  for (const id of ["add-sphere", "add-box", "add-painting"]) $(id).disabled = !state.opened || Boolean(painting);
  // The state comes often while something runs: what is being clicked or typed stays as long as it is true.
  const key = JSON.stringify([state.masks, chosen, selected(), state.opened && state.opened.names.length]);
  const typed = document.activeElement;
  if (key === shownList || ($("parts").contains(typed) && typed.type === "number")) return;
  shownList = key;
  $("masked").replaceChildren(...state.masks.map((target, index) => element("option", target.title, { value: index })));
  $("masked").value = chosen;
  $("masked").hidden = state.masks.length < 2;
  $("parts").replaceChildren(...parts().map(partRow));
}

let shareOf = "";

// Says how much of the shown frame's smoke is in the mask: what holds none of it cannot be tried.
async function showShare() {
  $("share").hidden = !parts().length || !state.opened;
  const key = JSON.stringify([state.opened, state.masks, targetIndex(), frameIndex()]);
  if ($("share").hidden || key === shareOf) return;
  shareOf = key;
  let text = "", share = null;
  try {
    ({ share } = await got(`share?${new URLSearchParams({ target: targetIndex(), frame: frameIndex() })}`));
    const percent = share > 0 && share < 0.01 ? "less than 1%" : `${Math.round(100 * share)}%`;
    text = `${percent} of this frame's smoke ${parts().length > 1 ? "is in all of these, where it changes" : "is in it and changes"}.`;
  } catch (error) {
    text = error.message;
  }
  if (key !== shareOf) return; // it has changed by now
  $("share").textContent = text;
  $("share").classList.toggle("none", !share);
}

$("masked").addEventListener("change", () => { asked = 0; showParts(); look(); });
$("masks-shown").addEventListener("change", () => { showParts(); look(); });

// In the middle of what is seen, as deep as the middle of the smoke, and about half as large.
async function addShape(shape) {
  await askPlace();
  if (!place) return;
  if (!place.smoke) { complain("There is no smoke in this frame to put a region in."); return; }
  const { right, up, towards } = cameraAxes(), corners = place.smoke.map(fromScene);
  const middle = times(plus(corners[0], corners[1]), 0.5);
  const seen = plus(plus(times(right, view.right), up, view.up), towards, dot(middle, towards));
  // Not beside the smoke, where nothing would change.
  const centre = seen.map((value, axis) => {
    const [low, high] = corners.map((corner) => corner[axis]).sort((a, b) => a - b);
    return Math.min(high, Math.max(low, value));
  });
  const half = plus(corners[1], corners[0], -1).map((size) => Math.max(1, Math.min(Math.abs(size) / 4, view.height / 4)));
  const radius = Math.max(...half), edge = tidy(0.3 * (shape === "sphere" ? radius : Math.min(...half)) * cellEdge());
  const at = toScene(centre), halfInScene = directionToScene(half).map(Math.abs);
  const values = shape === "sphere"
    ? { shape, centre: inScene(at), radius: tidy(radius * cellEdge()), edge }
    : { shape, low: inScene(plus(at, halfInScene, -1)), high: inScene(plus(at, halfInScene)), edge };
  asked = parts().length;
  await edit("add", 0, values);
}
$("add-sphere").addEventListener("click", () => addShape("sphere"));
$("add-box").addEventListener("click", () => addShape("box"));

/* ---- shapes and their handles in the view ------------------------------------------------------------------------ */

const movable = (part) => (part.form === "sphere" || part.form === "box")
  && !["centre", "radius", "low", "high", "edge"].some((key) => keyed(part.table[key]));

function sphereLines(centre, radius) {
  const circle = (a, b) => Array.from({ length: 49 }, (_, step) => {
    const turn = step / 48 * 2 * Math.PI;
    return plus(plus(centre, a, radius * Math.cos(turn)), b, radius * Math.sin(turn));
  });
  const { right, up } = cameraAxes();
  return [circle([1, 0, 0], [0, 1, 0]), circle([0, 1, 0], [0, 0, 1]), circle([0, 0, 1], [1, 0, 0]), circle(right, up)];
}

function boxLines(low, high) {
  const corner = (bits) => fromScene([0, 1, 2].map((axis) => (bits >> axis & 1 ? high : low)[axis]));
  const lines = [];
  for (let bits = 0; bits < 8; bits++) {
    for (let axis = 0; axis < 3; axis++) if (!(bits >> axis & 1)) lines.push([corner(bits), corner(bits | 1 << axis)]);
  }
  return lines;
}

// Outlines of a part: where its mask begins, and where it is whole.
function outlines(part) {
  const { table } = part, edge = table.edge || 0;
  if (part.form === "sphere") {
    const centre = fromScene(table.centre), inner = (table.radius - edge) / cellEdge();
    return [sphereLines(centre, table.radius / cellEdge()), edge && inner > 0 ? sphereLines(centre, inner).slice(3) : []];
  }
  const low = table.low.map((value) => value + edge), high = table.high.map((value) => value - edge);
  const whole = edge && low.every((value, axis) => value < high[axis]);
  return [boxLines(table.low, table.high), whole ? boxLines(low, high) : []];
}

// Each handle with its place, and what dragging it by pixels makes of the table as it was.
function handles(part) {
  const { table } = part, size = cellEdge(), { right } = cameraAxes(), edge = table.edge || 0;
  if (part.form === "sphere") {
    const centre = fromScene(table.centre), at = (length) => plus(centre, right, length / size);
    const left = at(edge - table.radius);
    return [
      { name: "centre", at: centre, drag: (x, y) => ({ centre: inScene(toScene(plus(centre, movedInPicture(centre, x, y)))) }) },
      { name: "radius", at: at(table.radius), drag: (x, y) => ({
        radius: tidy(Math.max(0.5 * size, table.radius + size * movedAlong(at(table.radius), right, x, y))),
      }) },
      { name: "edge", at: left, drag: (x, y) => ({
        edge: tidy(Math.min(table.radius, Math.max(0, edge + size * movedAlong(left, right, x, y)))),
      }) },
    ];
  }
  const middle = times(plus(table.low, table.high), 0.5), centre = fromScene(middle);
  const made = [{ name: "centre", at: centre, drag: (x, y) => {
    const by = directionToScene(movedInPicture(centre, x, y));
    return { low: inScene(plus(table.low, by)), high: inScene(plus(table.high, by)) };
  } }];
  for (let axis = 0; axis < 3; axis++) {
    const unit = [0, 1, 2].map((other) => Number(other === axis)), direction = directionFromScene(unit);
    for (const key of ["low", "high"]) {
      const at = fromScene(middle.map((value, other) => (other === axis ? table[key][axis] : value)));
      const from = projected(at), to = projected(plus(at, times(direction, size)));
      // Faces that are seen from straight ahead cannot be dragged: their direction is that of the view.
      if (!from || !to || Math.hypot(to[0] - from[0], to[1] - from[1]) < 0.25 * pixelsPerCell()) continue;
      made.push({ name: `${key} ${"xyz"[axis]}`, at, drag: (x, y) => {
        const moved = [...table[key]], value = moved[axis] + movedAlong(at, direction, x, y);
        moved[axis] = tidy(key === "low" ? Math.min(value, table.high[axis] - size) : Math.max(value, table.low[axis] + size));
        return { [key]: moved };
      } });
    }
  }
  // The corner of what is whole, on its way to that of the box which is nearest to the upper right.
  const cornersOf = [0, 1, 2, 3, 4, 5, 6, 7].map((bits) => [0, 1, 2].map((axis) => (bits >> axis & 1 ? 1 : -1)));
  const corner = (signs, inset) => fromScene(signs.map((sign, axis) => (sign > 0 ? table.high[axis] - inset : table.low[axis] + inset)));
  const rank = (signs) => { const seen = projected(corner(signs, 0)); return seen ? seen[0] - seen[1] : -Infinity; };
  const signs = cornersOf.reduce((best, other) => (rank(other) > rank(best) ? other : best));
  const inwards = directionFromScene(times(signs, -1)), at = corner(signs, edge);
  const most = Math.min(...plus(table.high, table.low, -1)) / 2;
  made.push({ name: "edge", at, drag: (x, y) => ({ edge: tidy(Math.min(most, Math.max(0, edge + movedAlong(at, inwards, x, y)))) }) });
  return made;
}

function gizmoHandles() {
  const usable = !painting && $("masks-shown").checked && $("cut").value === "none" && place && state && state.opened;
  const part = usable ? parts()[selected()] : null;
  return part && movable(part) ? handles(part) : [];
}

function drawGizmos() {
  const drawn = $("gizmos"), ratio = window.devicePixelRatio || 1, pen = drawn.getContext("2d");
  drawn.width = Math.round(canvas.clientWidth * ratio);
  drawn.height = Math.round(canvas.clientHeight * ratio);
  pen.scale(ratio, ratio);
  if (painting) { drawPainting(pen); return; }
  if (!state || !state.opened || !place || $("cut").value !== "none" || !$("masks-shown").checked) return;
  for (const [index, part] of parts().entries()) {
    if (!movable(part)) continue;
    const { follow } = part.table, from = follow === true ? state.opened.numbers[0] : follow;
    // In other frames than that from which it follows the smoke, a shape is not where its mask is.
    const elsewhere = from !== undefined && from !== state.opened.numbers[frameIndex()];
    for (const [which, lines] of outlines(part).entries()) {
      pen.strokeStyle = index === selected() ? MASK_COLOUR : "#ffffff80";
      pen.globalAlpha = elsewhere ? 0.35 : 0.9;
      pen.setLineDash(which ? [3, 4] : []);
      for (const line of lines) {
        const seen = line.map(projected).filter(Boolean);
        pen.beginPath();
        for (const [x, y] of seen) pen.lineTo(x, y);
        pen.stroke();
      }
    }
  }
  pen.globalAlpha = 1;
  pen.setLineDash([]);
  for (const { name, at } of gizmoHandles()) {
    const seen = projected(at);
    if (!seen) continue;
    pen.beginPath();
    if (name === "edge") pen.rect(seen[0] - HANDLE + 1, seen[1] - HANDLE + 1, 2 * HANDLE - 2, 2 * HANDLE - 2);
    else pen.arc(...seen, name === "centre" ? HANDLE + 1 : HANDLE, 0, 2 * Math.PI);
    pen.fillStyle = name === "centre" ? MASK_COLOUR : "#fff";
    pen.fill();
    pen.strokeStyle = "#000";
    pen.stroke();
  }
  drawn.dataset.handles = JSON.stringify(gizmoHandles().map(({ name, at }) => [name, projected(at)]));
}

let grasped = null;
function handleAt(event) {
  const bounds = canvas.getBoundingClientRect(), x = event.clientX - bounds.left, y = event.clientY - bounds.top;
  const distance = ({ at }) => { const seen = projected(at); return seen ? Math.hypot(seen[0] - x, seen[1] - y) : Infinity; };
  const near = gizmoHandles().filter((handle) => distance(handle) < GRASP);
  return near.sort((a, b) => distance(a) - distance(b))[0] || null;
}

// Before the view's own listeners, which would turn the camera.
const stage = $("stage");
stage.addEventListener("pointerdown", (event) => {
  if (event.target !== canvas) return;
  if (painting && event.button === 0 && !event.shiftKey) beginStroke(event);
  else if (!painting && event.button === 0 && (grasped = handleAt(event))) Object.assign(grasped, { x: event.clientX, y: event.clientY });
  else return;
  event.stopPropagation();
  canvas.setPointerCapture(event.pointerId);
}, true);
stage.addEventListener("pointermove", (event) => {
  if (stroke) { continueStroke(event); event.stopPropagation(); return; }
  if (grasped) {
    editSoon(selected(), grasped.drag(event.clientX - grasped.x, event.clientY - grasped.y));
    event.stopPropagation();
    return;
  }
  if (painting) { hover = pictured(event); drawGizmos(); }
  stage.classList.toggle("grabbable", Boolean(handleAt(event)));
}, true);
for (const end of ["pointerup", "pointercancel"]) {
  stage.addEventListener(end, () => { stroke = grasped = null; }, true);
}

/* ---- painting ---------------------------------------------------------------------------------------------------- */

let painting = null, stroke = null, hover = null;

// Where in the painting, in parts of the height of its frame from the upper left, something on the page is.
function pictured(event) {
  const bounds = canvas.getBoundingClientRect(), [rows, columns] = painting.size, cell = 1 / pixelsPerCell();
  const right = view.right + (event.clientX - bounds.left - canvas.clientWidth / 2) * cell;
  const up = view.up - (event.clientY - bounds.top - canvas.clientHeight / 2) * cell;
  return [(right + columns / 2) / rows, (rows / 2 - up) / rows];
}

const blocked = ["perspective", "cut", "home"]; // what would take the camera from where the painting is seen

async function beginPainting() {
  if (!state || !state.opened || painting) return;
  $("perspective").checked = false;
  $("cut").value = "none";
  shownMode();
  const size = state.opened.painted_size, [rows, columns] = size, scale = PAINTED_ROWS / Math.max(rows, columns);
  const sheet = element("canvas", undefined, { width: Math.round(columns * scale), height: Math.round(rows * scale) });
  painting = { size, sheet, strokes: [], view: [view.azimuth, view.elevation], opened: shownKey };
  for (const id of blocked) $(id).disabled = true;
  $("brush").hidden = false;
  stage.classList.add("painting");
  showParts();
  look();
}

function endPainting() {
  painting = stroke = hover = null;
  for (const id of blocked) $(id).disabled = false;
  shownMode();
  $("brush").hidden = true;
  stage.classList.remove("painting");
  showParts();
  look();
}

function beginStroke(event) {
  stroke = { erase: $("brush-erase").classList.contains("on"), size: Number($("brush-size").value), soft: Number($("brush-soft").value), points: [] };
  painting.strokes.push(stroke);
  continueStroke(event);
}

function continueStroke(event) {
  stroke.points.push(hover = pictured(event));
  repaint();
}

// The painting from its strokes, each of which is drawn by itself so that it is as opaque everywhere.
function repaint() {
  const { sheet, strokes } = painting, pen = sheet.getContext("2d"), unit = sheet.height;
  pen.clearRect(0, 0, sheet.width, sheet.height);
  for (const { erase, size, soft, points } of strokes) {
    pen.save();
    pen.globalCompositeOperation = erase ? "destination-out" : "source-over";
    pen.strokeStyle = pen.fillStyle = MASK_COLOUR;
    pen.lineCap = pen.lineJoin = "round";
    pen.filter = soft ? `blur(${soft * size * unit / 4}px)` : "none";
    pen.lineWidth = size * unit * (1 - soft / 2);
    pen.beginPath();
    pen.moveTo(points[0][0] * unit, points[0][1] * unit);
    for (const [x, y] of points) pen.lineTo(x * unit + 0.01, y * unit); // lines without a length are not drawn
    pen.stroke();
    pen.restore();
  }
  drawGizmos();
}

function drawPainting(pen) {
  const [rows, columns] = painting.size, cell = pixelsPerCell();
  const left = (canvas.clientWidth - columns * cell) / 2 - view.right * cell, top = (canvas.clientHeight - rows * cell) / 2 + view.up * cell;
  pen.globalAlpha = 0.6;
  pen.drawImage(painting.sheet, left, top, columns * cell, rows * cell);
  pen.globalAlpha = 1;
  pen.strokeStyle = "#fff";
  pen.setLineDash([5, 4]);
  pen.strokeRect(left, top, columns * cell, rows * cell);
  if (!hover) return;
  pen.setLineDash([]);
  pen.beginPath();
  pen.arc(left + hover[0] * rows * cell, top + hover[1] * rows * cell, Number($("brush-size").value) / 2 * rows * cell, 0, 2 * Math.PI);
  pen.stroke();
}

async function usePainting() {
  const { sheet, view: [azimuth, elevation] } = painting, target = targetIndex();
  const file = await new Promise((done) => sheet.toBlob(done, "image/png"));
  try {
    const where = new URLSearchParams({ target, azimuth, elevation, frame: frameIndex() });
    await answered(await fetch(`painting?${where}`, { method: "POST", body: file }));
    complain("");
    asked = parts().length;
    endPainting();
  } catch (error) {
    complain(error.message);
  }
}

function chooseBrush(erase) {
  $("brush-paint").classList.toggle("on", !erase);
  $("brush-erase").classList.toggle("on", erase);
}

$("add-painting").addEventListener("click", beginPainting);
$("brush-paint").addEventListener("click", () => chooseBrush(false));
$("brush-erase").addEventListener("click", () => chooseBrush(true));
$("brush-undo").addEventListener("click", () => { painting.strokes.pop(); repaint(); });
$("brush-clear").addEventListener("click", () => { painting.strokes = []; repaint(); });
$("brush-done").addEventListener("click", usePainting);
$("brush-cancel").addEventListener("click", endPainting);

/* ---- what the page tells ------------------------------------------------------------------------------------------ */

document.addEventListener("drawn", () => { askPlace(); showShare(); drawGizmos(); });
document.addEventListener("told", () => {
  if (painting && painting.opened !== shownKey) { complain("Something else has been opened; what was painted is gone."); endPainting(); }
  const before = alsoAsked.mask;
  showParts();
  if (alsoAsked.mask !== before) look();
  askPlace();
  showShare();
});
