"use strict";

// What can be chosen: files, and motifs.

const entriesOf = (at) => got(`files?${new URLSearchParams({ at })}`);
let listed = { at: "", entries: "" }, listings = 0; // the folder that is shown, and its entries; how often one was chosen

async function list(at) {
  const asked = listings += 1;
  let entries;
  try { entries = await entriesOf(at); } catch (error) { complain(error.message); return; }
  if (asked === listings) showFiles(at, entries);
}

function showFiles(at, entries) {
  listed = { at, entries: JSON.stringify(entries) };
  $("place").textContent = at;
  const rows = [];
  if (at) {
    const up = element("button", "‹ back");
    up.addEventListener("click", () => list(at.split("/").slice(0, -1).join("/")));
    rows.push(up);
  }
  for (const entry of entries) {
    if (entry.kind === "more") { rows.push(element("p", entry.name)); continue; }
    const mark = { run: "● ", folder: "▸ ", frames: "" }[entry.kind];
    const row = element("button", mark + entry.name, { className: entry.kind, title: entry.path });
    row.dataset.path = entry.path;
    if (state && state.opened && state.opened.path === entry.path) row.classList.add("on");
    row.addEventListener("click", () => entry.kind === "folder" ? list(entry.path) : post("open", { path: entry.path }));
    rows.push(row);
  }
  if (entries.filter((entry) => entry.kind === "frames").length > 1) {
    const all = element("button", "all frames of this folder", { id: "all" });
    all.addEventListener("click", () => post("open", { path: at || "." }));
    rows.unshift(all);
  }
  $("files").replaceChildren(...rows);
}

// Files come and go: looks again, and leaves what is shown alone as long as it is true.
async function listAgain() {
  const asked = listings, { at } = listed;
  let entries;
  try { entries = await entriesOf(at); } catch { return; } // that the folder is gone is said when one clicks there
  if (asked === listings && JSON.stringify(entries) !== listed.entries) showFiles(at, entries);
}
$("files").addEventListener("pointerenter", listAgain);
window.addEventListener("focus", listAgain);

let listedWork = "";
document.addEventListener("told", () => {
  const work = JSON.stringify(state.work.map((job) => [job.id, job.status]));
  if (listedWork && work !== listedWork) listAgain(); // results are files, too
  listedWork = work;
});

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
  const sought = $("find").value.trim();
  if (!tiles.length) {
    const instead = finder === byName ? "; a picture can be searched for too" : "";
    tiles.push(element("h3", `nothing is called '${sought}'${instead}`));
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
  if (await sent(`upload?${new URLSearchParams({ name: file.name })}`, { body: file })) find();
}
$("picture").addEventListener("change", (event) => { for (const file of event.target.files) upload(file); event.target.value = ""; });
document.addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("dropping"); });
document.addEventListener("dragleave", () => document.body.classList.remove("dropping"));
document.addEventListener("drop", (event) => {
  event.preventDefault();
  document.body.classList.remove("dropping");
  for (const file of event.dataTransfer.files) upload(file);
});
