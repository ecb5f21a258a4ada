"use strict";

const $ = (id) => document.getElementById(id);
const MODES = ["before", "wipe", "after", "difference", "movement"];
const COARSE_ROWS = 400; // of pictures while the camera moves
const LIT_ROWS = [110, 160, 240, 360]; // of path-traced ones, the more the faster they come
const LIT_LIMIT = 400; // milliseconds that a pass may take: the next move has to wait for it
const STILL_AFTER = 160; // milliseconds after which the camera counts as still
const LIT_PASSES = 32; // of a path-traced picture, one after the other

let state = null; // what all tabs share, as the server tells it
const view = { azimuth: 0, elevation: 0, height: 100, right: 0, up: 0 }; // this tab's camera
let mode = "before", wipe = 0.5;
const alsoAsked = {}; // what other scripts of the page want of its pictures

/* ---- talking to the server ---------------------------------------------------------------------------------- */

function complain(text) {
  $("error").textContent = text || "";
  $("error").hidden = !text;
}

async function answered(response) {
  if (response.ok) return response;
  let text = `${response.status}`;
  try { text = (await response.json()).error; } catch { /* not ours: the status has to do */ }
  throw new Error(text);
}

async function post(path, values) {
  try {
    const headers = { "Content-Type": "application/json" };
    await answered(await fetch(path, { method: "POST", headers, body: JSON.stringify(values) }));
    complain("");
    return true;
  } catch (error) {
    complain(error.message);
    return false;
  }
}

async function got(path) {
  return (await answered(await fetch(path))).json();
}

function element(tag, text, properties = {}) {
  const made = Object.assign(document.createElement(tag), properties);
  if (text !== undefined) made.textContent = text;
  return made;
}

/* ---- the view ------------------------------------------------------------------------------------------------ */

const canvas = $("view"), pictures = {};
let waiting = false, wanted = false, movedAt = 0, stillTimer = 0, pass = 0, fineness = LIT_ROWS.length - 1;

function sides() {
  if (mode === "movement") return [movementSide()];
  return mode === "wipe" ? ["before", "after"] : [mode];
}

function query(side, coarse, lit) {
  const width = canvas.clientWidth, height = canvas.clientHeight;
  const shrink = Math.min(1, (coarse ? COARSE_ROWS : lit ? LIT_ROWS[fineness] : 1080) / height, 1920 / width);
  return new URLSearchParams({
    frame: $("frame").value, mode: side, look: $("look").value, lit: lit ? 1 : 0,
    azimuth: view.azimuth, elevation: view.elevation, height: view.height, right: view.right, up: view.up,
    perspective: $("perspective").checked ? 1 : 0, cut: $("cut").value, at: $("at").value, coarse: coarse ? 1 : 0,
    rows: Math.max(8, Math.round(height * shrink)), columns: Math.max(8, Math.round(width * shrink)),
    ...alsoAsked,
  });
}

async function picture(side, coarse, lit) {
  const response = await answered(await fetch(`view?${query(side, coarse, lit)}`));
  return createImageBitmap(await response.blob());
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
    const canBeLit = $("lit").checked && $("cut").value === "none" && ["before", "after", "wipe"].includes(mode);
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
      if (mode === "movement") await askMovement(query("after", moving, false));
      complain("");
      if (lit && pass < LIT_PASSES) wanted = true;
      const [d, h, w] = state.opened.shape;
      const total = Math.round(performance.now() - begun);
      $("status").textContent = `${w}×${h}×${d} cells · ${total} ms` + (lit ? ` · pass ${pass} of ${LIT_PASSES}` : "");
      draw();
    } catch (error) {
      complain(error.message);
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
    if (mode === "wipe" && side === "after") {
      pen.beginPath();
      pen.rect(wipe * width, 0, width, height);
      pen.clip();
    }
    pen.drawImage(pictures[side], 0, 0, width, height);
    pen.restore();
  }
  if (mode === "movement") drawMovement(pen, width, height);
  if (mode === "wipe") {
    pen.fillStyle = "#fff";
    pen.fillRect(wipe * width - 1, 0, 2, height);
    pen.beginPath();
    pen.arc(wipe * width, height / 2, 7, 0, 2 * Math.PI);
    pen.fill();
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
  const atWipe = mode === "wipe" && Math.abs(event.offsetX - wipe * canvas.clientWidth) < 12;
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
  button.addEventListener("click", () => { mode = name; shownMode(); look(); });
  $("modes").append(button);
}

function shownMode() {
  const after = Boolean(state && state.opened && state.opened.after);
  if (!after) mode = "before";
  for (const name of MODES) {
    $(`mode-${name}`).classList.toggle("on", name === mode);
    $(`mode-${name}`).disabled = !after && name !== "before";
  }
  shownMovement();
  $("physics").textContent = (state && state.physics) || "";
  $("physics").hidden = !$("physics").textContent || $("look").value !== "network";
  const cut = $("cut").value !== "none";
  $("at").hidden = !cut;
  for (const id of ["lit", "perspective"]) $(id).parentElement.hidden = cut;
  $("lit").disabled = $("look").value === "network";
  if ($("lit").disabled) $("lit").checked = false;
}

for (const id of ["look", "lit", "cut", "perspective", "moved-as"]) $(id).addEventListener("change", () => { shownMode(); look(); });
$("at").addEventListener("input", () => look());
$("home").addEventListener("click", home);

let playing = 0;
function showFrame() {
  $("name").textContent = state.opened.names[Number($("frame").value)];
  look();
}
$("frame").addEventListener("input", showFrame);
$("play").addEventListener("click", () => {
  if (playing) { clearInterval(playing); playing = 0; } else {
    playing = setInterval(() => {
      if (waiting) return; // as fast as pictures come
      $("frame").value = (Number($("frame").value) + 1) % state.opened.names.length;
      showFrame();
    }, 1000 / 12);
  }
  $("play").textContent = playing ? "❚❚" : "▶";
});

/* ---- files --------------------------------------------------------------------------------------------------- */

async function list(at) {
  let entries;
  try { entries = await got(`files?${new URLSearchParams({ at })}`); } catch (error) { complain(error.message); return; }
  $("place").textContent = at;
  const rows = [];
  if (at) {
    const up = element("button", "‹ back");
    up.addEventListener("click", () => list(at.split("/").slice(0, -1).join("/")));
    rows.push(up);
  }
  for (const entry of entries) {
    const mark = { run: "● ", folder: "▸ ", frames: "" }[entry.kind];
    const row = element("button", mark + entry.name, { className: entry.kind, title: entry.path });
    row.dataset.path = entry.path;
    if (state && state.opened && state.opened.path === entry.path) row.classList.add("on");
    row.addEventListener("click", () => entry.kind === "folder" ? list(entry.path) : post("open", { path: entry.path }));
    rows.push(row);
  }
  if (entries.some((entry) => entry.kind === "frames") && entries.length > 1) {
    const all = element("button", "all frames of this folder", { id: "all" });
    all.addEventListener("click", () => post("open", { path: at || "." }));
    rows.unshift(all);
  }
  $("files").replaceChildren(...rows);
}

/* ---- motifs -------------------------------------------------------------------------------------------------- */

let motifs = [];
const byName = () => got(`motifs?${new URLSearchParams({ find: $("find").value })}`);
let finder = byName; // alike.js has another one

// Whether something could be asked for; what comes after another question is not shown.
async function find() {
  const asked = finder;
  let found;
  try { found = await asked(); } catch (error) { complain(error.message); return false; }
  if (asked === finder) { motifs = found; showMotifs(); }
  return true;
}

function chosen(motif) {
  return Boolean(state) && state.goals.some((goal) => goal.key === motif.key && goal.goal === motif.goal);
}

function showMotifs() {
  let kind = "";
  const tiles = [];
  for (const motif of motifs) {
    if (motif.kind !== kind) tiles.push(element("h3", kind = motif.kind));
    const tile = element("button", undefined, { title: `${motif.key} = ${motif.goal}` });
    Object.assign(tile.dataset, { key: motif.key, goal: motif.goal });
    if (motif.thumbnail) tile.append(element("img", undefined, { src: motif.thumbnail, alt: "", loading: "lazy" }));
    else tile.classList.add("wide");
    tile.append(motif.title);
    tile.addEventListener("click", () => post("goal", { key: motif.key, goal: motif.goal }));
    tiles.push(tile);
  }
  $("motifs").replaceChildren(...tiles);
  showExamples();
  markMotifs();
}

function markMotifs() {
  for (const tile of $("motifs").querySelectorAll("button")) tile.classList.toggle("on", chosen(tile.dataset));
}

let finding = 0;
$("find").addEventListener("input", () => { clearTimeout(finding); finding = setTimeout(find, 150); });

async function upload(file) {
  try {
    await answered(await fetch(`upload?${new URLSearchParams({ name: file.name })}`, { method: "POST", body: file }));
    complain("");
    find();
  } catch (error) {
    complain(error.message);
  }
}
$("picture").addEventListener("change", (event) => { for (const file of event.target.files) upload(file); event.target.value = ""; });
document.addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("dropping"); });
document.addEventListener("dragleave", () => document.body.classList.remove("dropping"));
document.addEventListener("drop", (event) => {
  event.preventDefault();
  document.body.classList.remove("dropping");
  for (const file of event.dataTransfer.files) upload(file);
});

/* ---- recipe -------------------------------------------------------------------------------------------------- */

const rows = {};
let sending = 0;

function knobRow(knob) {
  const row = element("div", undefined, { className: "knob" });
  const name = element("button", knob.key, { title: `${knob.label}: ${knob.help}`, className: "key" }), value = element("output");
  const slider = element("input", undefined, { type: "range", id: `knob-${knob.key}` });
  const help = element("p", `${knob.help} (${knob.expected})`, { hidden: true });
  slider.setAttribute("aria-label", knob.label);
  const ends = knob.logarithmic ? [Math.log10(knob.low), Math.log10(knob.high)] : [knob.low, knob.high];
  [slider.min, slider.max] = ends;
  slider.step = knob.step;
  name.addEventListener("click", () => { help.hidden = !help.hidden; });
  const asked = () => Number((knob.logarithmic ? 10 ** slider.value : Number(slider.value)).toPrecision(3));
  slider.addEventListener("input", () => {
    value.textContent = asked();
    clearTimeout(sending);
    sending = setTimeout(() => post("set", { key: knob.key, value: asked() }), 60);
  });
  row.append(name, slider, value);
  if (knob.word) {
    const word = element("button", knob.word, { title: `${knob.key} = "${knob.word}"` });
    word.addEventListener("click", () => post("set", { key: knob.key, value: knob.word }));
    row.append(word);
  }
  const back = element("button", "↺", { title: "as it was" });
  back.addEventListener("click", () => post("set", { key: knob.key, value: null }));
  row.append(back, help);
  $("knobs").append(row);
  return { row, slider, value, back };
}

function showRecipe() {
  for (const knob of state.knobs) {
    const { row, slider, value, back } = rows[knob.key] = rows[knob.key] || knobRow(knob);
    row.classList.toggle("set", knob.set);
    slider.disabled = Boolean(state.start) && !knob.free;
    slider.title = slider.disabled ? "stays as it was in what is gone on from" : "";
    back.hidden = !knob.set;
    if (document.activeElement === slider && slider.matches(":active")) continue;
    value.textContent = knob.keyframed ? "changes over the frames" : knob.value;
    if (typeof knob.value === "number") slider.value = knob.logarithmic ? Math.log10(knob.value) : knob.value;
  }
  const goals = state.goals.map((goal) => {
    const chip = element("span", undefined, { className: "goal" });
    const remove = element("button", "×", { title: "remove" });
    remove.addEventListener("click", () => post("goal", goal));
    const name = goal.key === "style" ? goal.goal.split("/").pop() : goal.goal;
    chip.append(element("span", `${goal.key} ${name}`, { title: goal.goal }), remove);
    return chip;
  });
  for (const key of state.other_goals) goals.push(element("span", `${key} of the recipe`, { className: "goal" }));
  $("goals").replaceChildren(...(goals.length ? goals : [element("small", "choose motifs on the left")]));
  $("try").disabled = $("render").disabled = !goals.length || !state.opened;
}

/* ---- what the server tells ------------------------------------------------------------------------------------ */

let shownKey = null, shownShape = null;

function told(next) {
  const shownParts = () => JSON.stringify([state.knobs, state.opened, state.masks]);
  const before = state && shownParts();
  state = next;
  const key = state.opened && JSON.stringify([state.opened.title, state.opened.path, state.opened.names]);
  shownMode();
  showRecipe();
  markMotifs();
  showJobs();
  if (key && key !== shownKey) {
    shownKey = key;
    $("hint").hidden = true;
    $("frame").max = state.opened.names.length - 1;
    $("frame").value = Math.min(Number($("frame").value), state.opened.names.length - 1);
    $("time").hidden = state.opened.names.length < 2;
    $("name").textContent = state.opened.names[Number($("frame").value)];
    document.title = `${state.opened.title} – tnst-mi studio`;
    if (state.opened.after && mode === "before") mode = "wipe";
    shownMode();
    // Results of one input are compared from where one is.
    const shape = JSON.stringify(state.opened.shape);
    if (shape === shownShape) look(); else home();
    shownShape = shape;
    for (const row of $("files").children) row.classList.toggle("on", row.dataset.path === state.opened.path);
    if (state.opened.notes.length) complain(state.opened.notes.join(" "));
  } else if (before !== shownParts()) {
    look();
  }
  document.dispatchEvent(new Event("told"));
}

// Once all scripts are there.
document.addEventListener("DOMContentLoaded", () => {
  const events = new EventSource("events");
  events.onmessage = (event) => { $("lost").hidden = true; told(JSON.parse(event.data)); };
  events.onerror = () => { $("lost").hidden = false; };
  list("");
  find();
});
