"use strict";

// Tries and renders: begun, watched, gone on from, and deleted.

const jobs = new Map(); // cards by the names of tries and renders
const chosenJobs = new Set(); // of this tab, kept when the other tries are deleted

const JOB_ACTIONS = { pause: "pause", resume: "resume", open: "open", finish: "render this", delete: "delete" };

const BEGINS = ["try", "render", "finish"];

let knownBefore = null; // names of what was there before something was begun here that is not yet listed

// Scrolls the card of what has been begun here into sight, once it is listed.
function showNext(known = knownBefore) {
  const begun = known && state.work.find((job) => !known.has(job.id));
  knownBefore = begun ? null : known;
  if (!begun) return;
  jobs.get(begun.id).card.scrollIntoView({ block: "nearest" });
  findPointed();
}

// Does what a button is for, with all that has been set, once: neither a double click nor impatience does it again. What
// has been set and is refused keeps it from being done. Whether it is done.
async function once(button, event, action) {
  if (event.detail > 1 || button.dataset.busy === "yes") return false;
  button.dataset.busy = "yes";
  button.disabled = true;
  const known = new Set(state.work.map((job) => job.id));
  try {
    const done = (await allIsSet()) && (!usesCluster(action) || (await clusterIsThere())) && (await post("work", action));
    if (done && BEGINS.includes(action.action)) showNext(known);
    return done;
  } finally {
    refusalsBefore = refusals; // which keep nothing back that is asked for once more
    delete button.dataset.busy;
    button.disabled = false;
    showRecipe();
  }
}

/* ---- the cluster -------------------------------------------------------------------------------------------- */

let clusterAsked = Promise.resolve(true); // whether the address in the field has been accepted
let clusterTyped = null; // the address in the field, while it is checked and when it has been refused

function usesCluster({ action, id }) {
  return action === "render" || action === "finish" || (action === "resume" && id.startsWith("renders/"));
}

function askCluster() {
  clusterTyped = $("cluster").value;
  clusterAsked = askClusterAfter(clusterAsked, clusterTyped);
}

async function askClusterAfter(before, typed) {
  await before;
  const accepted = await posted("cluster", { address: typed }, "cluster-error");
  if (clusterTyped !== typed) return accepted; // another one has been typed, which counts
  $("cluster").classList.toggle("wrong", !accepted);
  if (accepted) clusterTyped = null;
  return accepted;
}

// Whether renders are done where the field says. What has been refused is asked for again: a scheduler may answer by now.
async function clusterIsThere() {
  if ($("cluster").classList.contains("wrong")) askCluster();
  let asked = null, there = false;
  while (asked !== clusterAsked) {
    asked = clusterAsked;
    there = await asked;
  }
  return there;
}

function showCluster() {
  if (clusterTyped === null && document.activeElement !== $("cluster")) $("cluster").value = state.cluster;
}

/* ---- deleting ----------------------------------------------------------------------------------------------- */

// Delete tries or renders, after a question; running ones are stopped first, which may take a while: nothing waits for it.
function deleteJobs(ids, question) {
  const running = state.work.some((job) => ids.includes(job.id) && job.status === "running");
  const stopped = !running ? "" : ids.length === 1 ? " It is stopped first." : " Those that run are stopped first.";
  if (ids.length && window.confirm(`${question}${stopped} This cannot be undone.`)) posted("work", { action: "delete", ids });
}

function jobPicture(id, query) {
  return `work/picture?${new URLSearchParams({ id, ...query })}`;
}

/* ---- a card ------------------------------------------------------------------------------------------------- */

function jobCard(job) {
  const card = element("div", undefined, { className: "job" });
  const head = element("div", undefined, { className: "head" }), status = element("span");
  const choose = element("input", undefined, { type: "checkbox", title: "Choose: the others can be deleted together" });
  choose.setAttribute("aria-label", `choose ${job.title}`);
  choose.addEventListener("change", () => { chosenJobs[choose.checked ? "add" : "delete"](job.id); showChosen(); });
  choose.hidden = !job.id.startsWith("tries/");
  const by = job.network ? `, by the network ${job.network}` : "";
  head.append(choose, element("b", `${job.title}: ${job.of}`, { title: `${job.of}${by}` }), status);
  const bar = element("progress", undefined, { max: 1, hidden: true });
  bar.setAttribute("aria-label", "progress");
  const image = element("img", undefined, { alt: "before and after", hidden: true, title: "open" });
  image.addEventListener("click", (event) => once(image, event, { action: "open", id: job.id }));
  image.addEventListener("error", () => { image.hidden = true; });
  const graph = element("canvas", undefined, { hidden: true }), line = element("p"), told = element("p", "", { className: "told" });
  const buttons = element("div", undefined, { className: "buttons" }), actions = {};
  for (const [action, label] of Object.entries(JOB_ACTIONS)) {
    const button = actions[action] = element("button", label);
    button.dataset.action = action;
    button.addEventListener("click", (event) => {
      if (action === "delete") deleteJobs([job.id], `Delete ${job.title}?`); else once(button, event, { action, id: job.id });
    });
    buttons.append(button);
  }
  const branch = element("button", "go on from…", { title: "Choose a state that was kept, and go on from there with other settings" });
  const states = element("div", undefined, { className: "states", hidden: true });
  branch.dataset.action = "branch";
  branch.addEventListener("click", () => {
    states.hidden = !states.hidden;
    states.scrollIntoView({ block: "nearest" });
  });
  if (job.alone) actions.finish.textContent = "render this frame";
  actions.finish.title = `The whole recipe${job.alone ? ", of this frame" : ""}, from here to the end; nothing is computed twice`;
  buttons.insertBefore(branch, actions.delete);
  const of = new URLSearchParams({ id: job.id });
  const links = element("span", undefined, { className: "links" });
  for (const [name, path] of [["recipe.toml", "work/recipe"], ["log", "work/log"]]) {
    links.append(element("a", name, { href: `${path}?${of}`, target: "_blank", rel: "noopener" }));
  }
  const dashboard = element("a", "dashboard", { target: "_blank", rel: "noopener noreferrer", hidden: true, title: "Dask's own page on its cluster" });
  links.append(dashboard);
  buttons.append(links);
  card.append(head, bar, image, graph, line, told, buttons, states);
  return { card, choose, status, bar, image, graph, line, told, actions, branch, states, dashboard, picture: "", shown: "", offered: "" };
}

function showJob(shown, job, isShown) {
  shown.card.className = `job ${job.status}${isShown ? " shown" : ""}`;
  shown.card.dataset.id = job.id;
  const share = job.total ? Math.min(1, job.done / job.total) : 0;
  shown.status.textContent = job.status + (job.status === "done" || !job.total ? "" : ` · ${Math.floor(100 * share)} %`);
  shown.bar.hidden = job.status === "done" || !job.total;
  shown.bar.value = share;
  shown.line.textContent = job.line;
  shown.told.textContent = job.error || "";
  if (job.picture && job.picture !== shown.picture) {
    shown.picture = job.picture;
    shown.image.hidden = false;
    shown.image.src = jobPicture(job.id, { of: job.picture });
  }
  shown.graph.hidden = job.losses.length < 2;
  if (!shown.graph.hidden) curve(shown.graph, job.losses, job.octaves);
  for (const [action, button] of Object.entries(shown.actions)) button.hidden = !job.actions.includes(action);
  // A name of our own host is not the way to a dashboard that was opened elsewhere, but what the run has said.
  shown.dashboard.hidden = !job.dashboard;
  if (job.dashboard) shown.dashboard.href = job.dashboard;
  showStates(shown, job);
}

// The states that another try can go on from, each with its picture.
function showStates(shown, job) {
  shown.branch.hidden = !job.states.length;
  if (!job.states.length) shown.states.hidden = true;
  const offered = JSON.stringify([job.states, job.picture]);
  if (offered === shown.offered) return;
  shown.offered = offered;
  shown.states.replaceChildren(...job.states.map((kept) => {
    const tile = element("button", undefined, { title: `Go on from ${job.title}, ${kept.title}` });
    tile.dataset.octave = kept.octave === null ? "end" : kept.octave;
    const query = kept.octave === null ? { of: job.picture } : { octave: kept.octave };
    if (kept.picture) tile.append(element("img", undefined, { src: jobPicture(job.id, query), alt: "", loading: "lazy" }));
    tile.append(kept.title);
    tile.addEventListener("click", async (event) => {
      if (await once(tile, event, { action: "branch", id: job.id, octave: kept.octave })) shown.states.hidden = true;
    });
    return tile;
  }));
}

// The loss over the iterations; each octave has a scale of its own, since its losses are not those of others.
function curve(drawn, losses, octaves) {
  const width = drawn.width = 560, height = drawn.height = 88, pen = drawn.getContext("2d");
  pen.clearRect(0, 0, width, height);
  pen.lineWidth = 3;
  for (const octave of new Set(octaves)) {
    const places = losses.map((loss, index) => [index, loss]).filter(([index]) => octaves[index] === octave);
    const values = places.map(([, loss]) => loss), low = Math.min(...values), high = Math.max(...values);
    pen.beginPath();
    for (const [index, loss] of places) {
      const x = 4 + (width - 8) * index / Math.max(1, losses.length - 1);
      const y = 6 + (height - 12) * (high > low ? (high - loss) / (high - low) : 0.5);
      if (index === places[0][0]) pen.moveTo(x, y); else pen.lineTo(x, y);
    }
    pen.strokeStyle = octave % 2 ? "#ffd28a" : "#8fb8d8";
    pen.stroke();
  }
}

/* ---- all of them -------------------------------------------------------------------------------------------- */

function showJobs() {
  const cards = [];
  for (const job of state.work) {
    if (!jobs.has(job.id)) jobs.set(job.id, jobCard(job));
    const isShown = Boolean(state.opened) && state.opened.work === job.id;
    const shown = jobs.get(job.id), now = JSON.stringify([job, isShown]);
    if (now !== shown.shown) {
      shown.shown = now;
      showJob(shown, job, isShown);
    }
    cards.push(shown.card);
  }
  const there = [...$("work").children];
  if (cards.length !== there.length || cards.some((card, index) => card !== there[index])) $("work").replaceChildren(...cards);
  const ids = new Set(state.work.map((job) => job.id));
  for (const id of [...jobs.keys()].filter((known) => !ids.has(known))) {
    jobs.delete(id); // deleted, here or in another tab
    chosenJobs.delete(id);
  }
  showNext();
  showChosen();
  showStart();
}

function otherTries() {
  return state.work.map((job) => job.id).filter((id) => id.startsWith("tries/") && !chosenJobs.has(id));
}

function showChosen() {
  const others = otherTries().length;
  $("clear").hidden = !chosenJobs.size || !others;
  $("clear").textContent = `delete the ${others === 1 ? "other try" : `${others} other tries`}`;
}

// What the next try goes on from, and where renders are done.
function showStart() {
  const start = state.start, job = start && state.work.find((one) => one.id === start.id);
  const kept = job && job.states.find((one) => one.octave === start.octave);
  $("start").hidden = !job;
  $("start-text").textContent = job ? `goes on from ${job.title}, ${kept ? kept.title : "a state that is gone"}` : "";
  $("restricted").hidden = Boolean(job) || state.frames === null;
  $("restricted-text").textContent = `frames ${state.frames} only`;
  $("alone").hidden = Boolean(job) || !state.opened || !state.opened.of_several;
  showCluster();
}

document.addEventListener("DOMContentLoaded", () => {
  $("try").addEventListener("click", (event) => {
    const only = !$("alone").hidden && $("only").checked;
    once($("try"), event, { action: "try", alone: only ? frameIndex() : null });
  });
  $("render").addEventListener("click", (event) => once($("render"), event, { action: "render" }));
  $("anew").addEventListener("click", () => post("work", { action: "anew" }));
  $("all-frames").addEventListener("click", () => post("work", { action: "all-frames" }));
  $("clear").addEventListener("click", () => {
    const others = otherTries();
    deleteJobs(others, `Delete ${others.length === 1 ? "the other try" : `the ${others.length} other tries`}, all but the chosen?`);
  });
  $("cluster").addEventListener("change", askCluster);
});
