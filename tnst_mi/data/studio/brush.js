"use strict";
// Painting over the view, of which a mask is made.

const PAINTED_ROWS = 1024; // edge of a painting in pixels

let painting = null, stroke = null, hover = null;
const keptPaintings = new Map(); // that were not used when something else was opened, by what they are of
let saidOf = null; // what was opened when it was said of them last

// Where in the painting, in parts of the height of its frame from the upper left, something on the page is.
function pictured(event) {
  const bounds = canvas.getBoundingClientRect(), [rows, columns] = painting.size, cell = 1 / pixelsPerCell();
  const right = view.right + (event.clientX - bounds.left - canvas.clientWidth / 2) * cell;
  const up = view.up - (event.clientY - bounds.top - canvas.clientHeight / 2) * cell;
  return [(right + columns / 2) / rows, (rows / 2 - up) / rows];
}

const blocked = ["perspective", "cut", "home"]; // what would take the camera from where the painting is seen

function beginPainting() {
  if (!state || !state.opened || painting) return;
  $("perspective").checked = false;
  $("cut").value = "none";
  shownMode();
  const size = state.opened.painted_size, [rows, columns] = size, scale = PAINTED_ROWS / Math.max(rows, columns);
  const sheet = element("canvas", undefined, { width: Math.round(columns * scale), height: Math.round(rows * scale) });
  const kept = keptPaintings.get(shownKey);
  painting = { size, sheet, strokes: [], view: [view.azimuth, view.elevation], title: state.opened.title, opened: shownKey };
  if (kept && `${kept.size}` === `${size}`) {
    painting.strokes = kept.strokes;
    [view.azimuth, view.elevation] = painting.view = kept.view;
    repaint();
  }
  keptPaintings.delete(shownKey);
  complain("", "kept");
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

// Another tab may open something while one paints here: the strokes stay for when their smoke is seen again.
function keepPainting() {
  if (painting && painting.opened !== shownKey) {
    if (painting.strokes.length) keptPaintings.set(painting.opened, painting);
    endPainting();
  }
  if (saidOf === shownKey) return; // closed, perhaps
  saidOf = shownKey;
  const [latest] = [...keptPaintings.values()].slice(-1);
  if (keptPaintings.has(shownKey)) complain("What you have painted here is kept: paint goes on with it.", "kept");
  else if (latest) complain(`Something else has been opened. What you have painted over ${latest.title} is kept: open that, and paint goes on with it.`, "kept");
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

// Makes it a mask; whether it has become one.
async function usePainting() {
  const { sheet, view: [azimuth, elevation] } = painting, target = targetIndex(), frame = frameIndex();
  $("brush-done").disabled = true; // once
  const file = await new Promise((made) => sheet.toBlob(made, "image/png"));
  selectNext();
  const where = new URLSearchParams({ target, azimuth, elevation, frame });
  const used = await sent(`painting?${where}`, { body: file });
  $("brush-done").disabled = false;
  if (!used) {
    awaiting = null;
  } else {
    showMasks(true);
    if (painting && painting.sheet === sheet) endPainting(); // something else may be painted by now
  }
  return used;
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
$("brush-done").addEventListener("click", () => change(usePainting()));
$("brush-cancel").addEventListener("click", endPainting);
