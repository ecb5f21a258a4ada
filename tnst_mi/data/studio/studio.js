"use strict";

// What all tabs share, as the server tells it, shown by the other scripts.

let shownKey = null, shownShape = null, shownNotice = null;

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
  if (state.notice !== shownNotice) {
    shownNotice = state.notice;
    if (shownNotice) complain(shownNotice);
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
