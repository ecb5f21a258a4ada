"use strict";
// Regions: the masks of the recipe as a list.

let asked = null; // id of the part that is to have handles
let awaiting = null; // ids of those that were there when one was added, which is not there yet
const targetIndex = () => Number($("masked").value) || 0;
const selected = () => Math.max(0, parts().findIndex((part) => part.id === asked));
const parts = () => (state && state.masks[targetIndex()] ? state.masks[targetIndex()].parts : []);
const keyed = (value) => value !== null && typeof value === "object" && !Array.isArray(value);
const frameIndex = () => Number($("frame").value);

// Whether the mask and the outlines of its parts are drawn over the smoke.
function showMasks(shown) {
  const before = alsoAsked.mask;
  $("masks-shown").checked = shown;
  showParts();
  if (alsoAsked.mask !== before) look(); else drawGizmos();
}

// By the part's id: another tab may have changed the list. What is edited is shown.
function edited(action, id, values = {}) {
  if (action !== "remove") showMasks(true);
  return posted("mask", { action, target: targetIndex(), id, values, frame: frameIndex() });
}

function edit(action, id, values) {
  return change(edited(action, id, values));
}

function selectNext() {
  awaiting = new Set(parts().map((part) => part.id));
}

// Selects a part that has been added, and instead of one that is gone the last one.
function followSelection() {
  const added = awaiting && parts().findLast((part) => !awaiting.has(part.id));
  if (added) { asked = added.id; awaiting = null; }
  if (parts().length && !parts().some((part) => part.id === asked)) asked = parts().at(-1).id;
}

// Edits while something is dragged: one at a time, the latest of each part next.
let editing = false;
const nextEdits = new Map();
function editSoon(id, values) {
  nextEdits.set(id, { ...nextEdits.get(id), ...values });
  if (!editing) change(editAll());
}

// Whether the latest edit of each part has been made: those before it do not matter any more.
async function editAll() {
  const made = new Map();
  editing = true;
  while (nextEdits.size) {
    const [[part, latest]] = nextEdits;
    nextEdits.delete(part);
    made.set(part, await edited("change", part, latest));
  }
  editing = false;
  return [...made.values()].every(Boolean);
}

const tidy = (value) => Number(value.toPrecision(5));
const inScene = (point) => point.map((value) => tidy(value));

function numbersRow(part, key) {
  const row = element("div", undefined, { className: "row" }), value = part.table[key] ?? (key === "strength" ? 1 : 0);
  row.append(element("span", key));
  if (keyed(value)) {
    row.append(element("span", "changes over the frames", { style: "grid-column: 2 / -1" }));
    return row;
  }
  const inputs = (Array.isArray(value) ? value : [value]).map((number, axis, all) => {
    const input = element("input", undefined, { type: "number", step: "any", defaultValue: tidy(number) });
    input.dataset.field = `${part.id} ${key} ${axis}`;
    input.setAttribute("aria-label", all.length > 1 ? `${key} ${"xyz"[axis]}` : key);
    input.addEventListener("change", async () => {
      const numbers = inputs.map((other) => (other.value === "" ? null : Number(other.value)));
      const made = await edit("change", part.id, { [key]: all.length > 1 ? numbers : numbers[0] });
      if (!made) for (const other of inputs) other.value = other.defaultValue;
    });
    return input;
  });
  if (key === "strength") Object.assign(inputs[0], { min: 0, max: 1, step: 0.05 });
  row.append(...inputs);
  return row;
}

function switchFor(id, key, text, on, title) {
  const label = element("label", undefined, { title }), box = element("input", undefined, { type: "checkbox", checked: on });
  box.dataset.key = key;
  box.addEventListener("change", () => edit("change", id, { [key]: box.checked || null }));
  label.append(box, text);
  return label;
}

function partRow(part, index) {
  const row = element("div", undefined, { className: index === selected() ? "part on" : "part" });
  row.dataset.form = part.form;
  const head = element("div", undefined, { className: "head" }), name = element("button", part.title);
  const remove = element("button", "×", { title: "remove" });
  name.addEventListener("click", () => { asked = part.id; showMasks(true); });
  remove.addEventListener("click", () => edit("remove", part.id));
  head.append(name, remove);
  row.append(head);
  if (index !== selected()) return row;
  const keys = { sphere: ["centre", "radius", "edge"], box: ["low", "high", "edge"] }[part.form] || [];
  row.append(...[...keys, "strength"].map((key) => numbersRow(part, key)));
  const follow = part.table.follow ?? false, switches = element("div", undefined, { className: "switches" });
  const follows = `follow${typeof follow === "number" ? ` from frame ${follow}` : ""}`;
  switches.append(switchFor(part.id, "invert", "invert", Boolean(part.table.invert), "Everywhere but there"));
  if (state.opened && state.opened.names.length > 1) {
    switches.append(switchFor(part.id, "follow", follows, follow !== false, "Moves with the smoke from the shown frame on, by its velocities"));
  }
  row.append(switches);
  return row;
}

// Puts rows into the list, but leaves the one alone in which something is being typed: its text may not be a number yet.
function putRows(rows) {
  const typed = document.activeElement, field = $("parts").contains(typed) && typed.dataset.field;
  const old = field && typed.closest(".part"), numbers = field && typed.closest(".row");
  const made = field && rows.map((row) => row.querySelector(`[data-field="${field}"]`)).find(Boolean);
  const others = made ? [...made.closest(".row").querySelectorAll("input")] : [];
  const inputs = field ? [...numbers.querySelectorAll("input")] : [];
  if (!made || others.length !== inputs.length) {
    $("parts").replaceChildren(...rows);
    return;
  }
  for (const [index, input] of inputs.entries()) {
    input.defaultValue = others[index].defaultValue;
    if (input !== typed) input.value = input.defaultValue;
  }
  const row = made.closest(".part");
  replaceAround(old, numbers, [...row.children], made.closest(".row"));
  replaceAround($("parts"), old, rows, row);
}

// Makes elements the children of another one, of which a child stays in place of one of them.
function replaceAround(parent, kept, elements, instead) {
  const index = elements.indexOf(instead);
  for (const child of [...parent.children]) if (child !== kept) child.remove();
  kept.before(...elements.slice(0, index));
  kept.after(...elements.slice(index + 1));
}

let shownList = "";

function showParts() {
  if (!state) return;
  followSelection();
  const chosen = Math.min(targetIndex(), state.masks.length - 1);
  alsoAsked.mask = $("masks-shown").checked && state.masks[chosen].parts.length ? chosen : "none";
  for (const id of ["add-sphere", "add-box", "add-painting"]) $(id).disabled = !state.opened || Boolean(painting);
  // The state comes often while something runs: what is being clicked or typed stays as long as it is true.
  const key = JSON.stringify([state.masks, chosen, selected(), state.opened && state.opened.names.length]);
  if (key === shownList) return;
  shownList = key;
  $("masked").replaceChildren(...state.masks.map((target, index) => element("option", target.title, { value: index })));
  $("masked").value = chosen;
  $("masked").hidden = state.masks.length < 2;
  putRows(parts().map(partRow));
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
    text = `${percent} of this frame's smoke ${parts().length > 1 ? "is in all of these: only where they overlap it changes" : "is in it and changes; beside another region, only where both overlap"}.`;
  } catch (error) {
    text = error.message;
  }
  if (key !== shareOf) return; // it has changed by now
  $("share").textContent = text;
  $("share").classList.toggle("none", !share);
}

$("masked").addEventListener("change", () => { asked = null; showMasks(true); look(); });
$("masks-shown").addEventListener("change", () => { showParts(); look(); });

// In the middle of what is seen, as deep as the middle of the smoke, and about half as large. Whether it is there.
async function addShape(shape) {
  await askPlace();
  if (!place) return false;
  if (!place.smoke) { complain("There is no smoke in this frame to put a region in."); return false; }
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
  selectNext();
  const added = await edited("add", null, values);
  if (!added) awaiting = null;
  return added;
}
$("add-sphere").addEventListener("click", () => change(addShape("sphere")));
$("add-box").addEventListener("click", () => change(addShape("box")));

/* ---- what the page tells ------------------------------------------------------------------------------------------ */

document.addEventListener("drawn", () => { askPlace(); showShare(); drawGizmos(); });
document.addEventListener("told", () => {
  keepPainting();
  const before = alsoAsked.mask;
  showParts();
  if (alsoAsked.mask !== before) look();
  askPlace();
  showShare();
});
if (state) document.dispatchEvent(new Event("told")); // it may have come before this script
