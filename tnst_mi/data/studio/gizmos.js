"use strict";
// Spheres and boxes of a mask in the view, with handles that change them.

const HANDLE = 6, GRASP = 11; // radius of a handle in pixels, and distance from which it is grasped
const MASK_COLOUR = "#ff5c42";

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
  else if (!painting && event.button === 0 && (grasped = handleAt(event))) Object.assign(grasped, { part: parts()[selected()].id, x: event.clientX, y: event.clientY });
  else return;
  event.stopPropagation();
  canvas.setPointerCapture(event.pointerId);
}, true);
stage.addEventListener("pointermove", (event) => {
  if (stroke) { continueStroke(event); event.stopPropagation(); return; }
  if (grasped) {
    editSoon(grasped.part, grasped.drag(event.clientX - grasped.x, event.clientY - grasped.y));
    event.stopPropagation();
    return;
  }
  if (painting) { hover = pictured(event); drawGizmos(); }
  stage.classList.toggle("grabbable", Boolean(handleAt(event)));
}, true);
for (const end of ["pointerup", "pointercancel"]) {
  stage.addEventListener(end, () => { stroke = grasped = null; }, true);
}
