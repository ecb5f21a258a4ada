"use strict";
// Where points are: in the scene, in cells around the grid's centre, and in pixels of the view of studio.js.

const FIELD = 30; // vertical field of view of the perspective camera, in degrees

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
    complain("", "place-error");
    drawGizmos();
  } catch (error) {
    placeOf = "";
    complain(error.message, "place-error");
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
