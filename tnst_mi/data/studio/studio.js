"use strict";

// What all tabs share, as the server tells it, shown by the other scripts.

let shownKey = null, shownShape = null, shownNotice = null, shownRemark = "null";

// The frame with the number of the one that was shown; where there is none, of a try the first that it has stylized.
function showSameFrame(before) {
  const { names, numbers, stylized } = state.opened, slider = $("frame"), was = Number(slider.value);
  const same = before && before.numbers[was] !== null ? numbers.indexOf(before.numbers[was]) : -1;
  const there = same >= 0 ? same : Math.min(was, names.length - 1);
  slider.max = names.length - 1;
  slider.value = stylized.includes(there) ? there : stylized[0];
}

function told(next) {
  if (!next.opened && shownKey) { location.reload(); return; } // what was shown is gone, and its input too
  const shownParts = (of) => JSON.stringify([of.knobs, of.picks, of.opened, of.masks]);
  const before = state;
  state = next;
  const key = state.opened && JSON.stringify([state.opened.title, state.opened.path, state.opened.names]);
  shownMode();
  showRecipe();
  markMotifs();
  showJobs();
  if (key && key !== shownKey) {
    shownKey = key;
    $("hint").hidden = true;
    stopPlaying();
    showSameFrame(before && before.opened);
    $("time").hidden = state.opened.names.length < 2;
    $("name").textContent = state.opened.names[Number($("frame").value)];
    document.title = `${state.opened.title} – tnst-mi studio`;
    if (state.opened.after && mode === "before") mode = "wipe";
    // What has come out is compared as it is; where regions are, matters to what is still to be tried.
    showMasks(!state.opened.after);
    shownMode();
    // Results of one input are compared from where one is.
    const shape = JSON.stringify(state.opened.shape);
    if (shape === shownShape) look(); else home();
    shownShape = shape;
    for (const row of $("files").children) row.classList.toggle("on", row.dataset.path === state.opened.path);
    complain(state.opened.notes.join(" "), "notes");
  } else if (!before || shownParts(before) !== shownParts(state)) {
    look();
  }
  if (state.notice !== shownNotice) {
    shownNotice = state.notice;
    complain(shownNotice, "notice");
  }
  if (JSON.stringify(state.remark) !== shownRemark) {
    shownRemark = JSON.stringify(state.remark);
    showRemark();
  }
  $("network").textContent = state.network.flavour ? `of the network ${state.network.flavour}` : "no network can be used";
  $("network").title = `${state.network.file}; tnst-mi studio --weights names another one`;
  document.dispatchEvent(new Event("told"));
}

// What of the settings has stayed, with a button that takes it away where it was meant for other smoke.
function showRemark() {
  const { text, clears } = state.remark || { text: "" };
  complain(text, "remark");
  const there = $("remark").querySelector(".clear");
  if (there) there.remove();
  if (!clears) return;
  const clear = element("button", "clear", { className: "clear", title: "Remove all goals and regions" });
  clear.addEventListener("click", () => post("clear", {}));
  $("remark").firstChild.after(clear);
}

let events = null;

// A browser has six connections to the studio, for all its tabs: those that nobody sees leave theirs to the others.
function followNews() {
  if (document.visibilityState === "hidden") {
    if (events) events.close();
  } else if (!events || events.readyState === EventSource.CLOSED) {
    events = new EventSource("events");
    events.onmessage = (event) => { $("lost").hidden = true; told(JSON.parse(event.data)); };
    events.onerror = () => { $("lost").hidden = false; };
  }
}
document.addEventListener("visibilitychange", followNews);

// Once all scripts are there.
document.addEventListener("DOMContentLoaded", () => {
  followNews();
  list("");
  find();
});
