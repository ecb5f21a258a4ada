"use strict";

// The view: pictures of what is opened, the camera with which they are seen, and what they show.

const MODES = ["before", "wipe", "after", "difference", "movement"];
const COARSE_ROWS = 400; // of pictures while the camera moves
const LIT_ROWS = [110, 160, 240, 360]; // of path-traced ones, the more the faster they come
const LIT_LIMIT = 400; // milliseconds that a pass may take: the next move has to wait for it
const STILL_AFTER = 160; // milliseconds after which the camera counts as still
const LIT_PASSES = 32; // of a path-traced picture, one after the other

const view = { azimuth: 0, elevation: 0, height: 100, right: 0, up: 0 }; // this tab's camera
let mode = "before", wipe = 0.5;
const alsoAsked = {}; // what other scripts of the page want of its pictures

const canvas = $("view"), pictures = {};
let waiting = false, wanted = false, movedAt = 0, stillTimer = 0, pass = 0, fineness = LIT_ROWS.length - 1;

// What of the shown frame is seen: of those that a try has not stylized there is nothing but what was before.
function shownAs() {
  return isStylized() ? mode : "before";
}

function isStylized() {
  return state.opened.stylized.includes(Number($("frame").value));
}

function sides() {
  const shown = shownAs();
  if (shown === "movement") return [movementSide()];
  return shown === "wipe" ? ["before", "after"] : [shown];
}

function query(side, coarse, lit) {
  const width = canvas.clientWidth, height = canvas.clientHeight;
  const shrink = Math.min(1, (coarse ? COARSE_ROWS : lit ? LIT_ROWS[fineness] : 1080) / height, 1920 / width);
  return new URLSearchParams({
    frame: $("frame").value, mode: side, look: $("look").value, lit: lit ? 1 : 0,
    azimuth: view.azimuth, elevation: view.elevation, height: view.height, right: view.right, up: view.up,
    perspective: $("perspective").checked ? 1 : 0, cut: $("cut").value, at: $("at").value, coarse: coarse ? 1 : 0,
    coloured: $("coloured").checked ? 1 : 0,
    rows: Math.max(8, Math.round(height * shrink)), columns: Math.max(8, Math.round(width * shrink)),
    ...alsoAsked,
  });
}

async function picture(side, coarse, lit) {
  const response = await answered(await fetch(`view?${query(side, coarse, lit)}`));
  return createImageBitmap(await response.blob());
}

// Of which try or render the picture is, if it is of one.
function shownWork() {
  const job = state.work.find((one) => one.id === state.opened.work);
  return job ? ` · ${job.title}: ${job.of}` : "";
}

// Asks for a picture, one at a time: what moves in the meantime is in the next one.
function look(moving = true) {
  if (moving) { movedAt = performance.now(); pass = 0; }
  wanted = true;
  canvas.dataset.settled = "no"; // what is shown is not yet, or not finely, what is wanted
  if (!waiting) update();
}

async function update() {
  if (!state || !state.opened || canvas.clientWidth === 0) return;
  waiting = true;
  while (wanted) {
    wanted = false;
    const moving = performance.now() - movedAt < STILL_AFTER;
    const canBeLit = $("lit").checked && $("cut").value === "none" && ["before", "after", "wipe"].includes(shownAs());
    const lit = canBeLit && !moving;
    if (lit) pass += 1;
    const begun = performance.now();
    try {
      for (const side of sides()) {
        if (lit && wanted) break; // something has moved
        const asked = performance.now();
        pictures[side] = await picture(side, moving, lit);
        // The first pass may have had to be compiled.
        if (lit && pass === 2) adapt(performance.now() - asked);
      }
      if (shownAs() === "movement") await askMovement(query("after", moving, false));
      complain("", "view-error");
      if (lit && pass < LIT_PASSES) wanted = true;
      const [d, h, w] = state.opened.shape;
      const total = Math.round(performance.now() - begun);
      $("status").textContent = `${w}×${h}×${d} cells · ${total} ms` + (lit ? ` · pass ${pass} of ${LIT_PASSES}` : "")
        + shownWork() + (isStylized() ? "" : " · this frame as it is: it was not in the try");
      draw();
    } catch (error) {
      complain(error.message, "view-error");
    }
    if (moving && !wanted) {
      clearTimeout(stillTimer);
      stillTimer = setTimeout(() => look(false), STILL_AFTER);
    } else if (!wanted) {
      canvas.dataset.settled = "yes";
    }
  }
  waiting = false;
}

// Makes path-traced pictures smaller, or larger, and begins them anew.
function adapt(taken) {
  const next = fineness + (taken > LIT_LIMIT ? -1 : taken < LIT_LIMIT / 4 ? 1 : 0);
  if (next === fineness || !(next in LIT_ROWS)) return;
  fineness = next;
  pass = 0;
}

function draw() {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const pen = canvas.getContext("2d");
  pen.scale(ratio, ratio);
  for (const side of sides()) {
    if (!pictures[side]) continue;
    pen.save();
    if (shownAs() === "wipe" && side === "after") {
      pen.beginPath();
      pen.rect(wipe * width, 0, width, height);
      pen.clip();
    }
    pen.drawImage(pictures[side], 0, 0, width, height);
    pen.restore();
  }
  if (shownAs() === "movement") drawMovement(pen, width, height);
  if (shownAs() === "wipe") {
    pen.fillStyle = "#fff";
    pen.fillRect(wipe * width - 1, 0, 2, height);
    pen.beginPath();
    pen.arc(wipe * width, height / 2, 7, 0, 2 * Math.PI);
    pen.fill();
    pen.font = "12px sans-serif";
    for (const [text, at, align] of [["before", -8, "right"], ["after", 8, "left"]]) {
      pen.textAlign = align;
      pen.strokeStyle = "#000a";
      pen.lineWidth = 3;
      pen.strokeText(text, wipe * width + at, height - 12);
      pen.fillText(text, wipe * width + at, height - 12);
    }
    pen.lineWidth = 1;
  }
  if ($("look").value === "network" && !$("perspective").checked && $("cut").value === "none") {
    // What the network sees: as many rows and columns as the grid has.
    const [, h, w] = state.opened.shape, cell = height / view.height;
    pen.strokeStyle = "#ffffff40";
    pen.setLineDash([4, 4]);
    pen.strokeRect((width - w * cell) / 2 - view.right * cell, (height - h * cell) / 2 + view.up * cell, w * cell, h * cell);
  }
  document.dispatchEvent(new Event("drawn"));
}

function home() {
  const [d, h, w] = state.opened.shape;
  const aspect = canvas.clientWidth / Math.max(1, canvas.clientHeight);
  [view.azimuth, view.elevation] = state.opened.main_view;
  view.height = Math.max(h, w / aspect, 0.6 * Math.hypot(d, h, w)) * 1.1;
  view.right = view.up = 0;
  look();
}

let dragged = null;
canvas.addEventListener("pointerdown", (event) => {
  canvas.setPointerCapture(event.pointerId);
  const atWipe = state && state.opened && shownAs() === "wipe" && Math.abs(event.offsetX - wipe * canvas.clientWidth) < 12;
  dragged = { x: event.clientX, y: event.clientY, what: atWipe ? "wipe" : event.button === 0 && !event.shiftKey ? "orbit" : "pan" };
});
canvas.addEventListener("pointermove", (event) => {
  if (!dragged) return;
  const x = event.clientX - dragged.x, y = event.clientY - dragged.y, cell = view.height / canvas.clientHeight;
  dragged.x = event.clientX;
  dragged.y = event.clientY;
  if (dragged.what === "wipe") {
    wipe = Math.min(1, Math.max(0, event.offsetX / canvas.clientWidth));
    draw();
    return;
  }
  if (dragged.what === "orbit") {
    view.azimuth -= 0.4 * x;
    view.elevation = Math.min(90, Math.max(-90, view.elevation + 0.4 * y));
  } else {
    view.right -= x * cell;
    view.up += y * cell;
  }
  look();
});
for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { dragged = null; });
canvas.addEventListener("contextmenu", (event) => event.preventDefault());
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  view.height = Math.min(1e5, Math.max(1, view.height * Math.exp(0.0012 * event.deltaY)));
  look();
}, { passive: false });
new ResizeObserver(() => look()).observe($("stage"));

/* ---- what is shown ------------------------------------------------------------------------------------------- */

for (const name of MODES) {
  const button = element("button", name, { id: `mode-${name}` });
  button.addEventListener("click", () => {
    mode = name;
    if (state.opened.after) showMasks(false); // results are compared without what is drawn over them
    shownMode();
    look();
  });
  $("modes").append(button);
}

function shownMode() {
  const shown = state && state.opened, after = Boolean(shown && shown.after);
  const gone = Boolean(shown && shown.run && !after); // its input: what there is has been stylized
  if (!after) mode = gone ? "after" : "before";
  for (const name of MODES) {
    const button = $(`mode-${name}`);
    button.classList.toggle("on", name === mode);
    button.disabled = !after && name !== mode;
    button.title = !button.disabled ? "" : gone ? shown.notes.join(" ") : "of a run, which has something before and after";
  }
  shownMovement();
  $("physics").textContent = (state && state.physics) || "";
  $("physics").hidden = !$("physics").textContent || $("look").value !== "network";
  const cut = $("cut").value !== "none";
  $("at").hidden = !cut;
  for (const id of ["lit", "perspective"]) $(id).parentElement.hidden = cut;
  $("in-colour").hidden = !(shown && shown.coloured);
  $("lit").disabled = $("look").value === "network";
  if ($("lit").disabled) $("lit").checked = false;
}

for (const id of ["look", "lit", "coloured", "cut", "perspective", "moved-as"]) $(id).addEventListener("change", () => { shownMode(); look(); });
$("at").addEventListener("input", () => look());
$("home").addEventListener("click", home);

let playing = 0;
function stopPlaying() {
  clearInterval(playing);
  playing = 0;
  $("play").textContent = "▶";
}

function showFrame() {
  $("name").textContent = state.opened.names[Number($("frame").value)];
  look();
}
$("frame").addEventListener("input", showFrame);
$("play").addEventListener("click", () => {
  if (playing) { stopPlaying(); } else {
    playing = setInterval(() => {
      if (waiting) return; // as fast as pictures come
      $("frame").value = (Number($("frame").value) + 1) % state.opened.names.length;
      showFrame();
    }, 1000 / 12);
    $("play").textContent = "❚❚";
  }
});
