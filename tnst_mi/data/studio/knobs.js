"use strict";

// The recipe: goals, and sliders for its keys.

const rows = {};
const waitingKnobs = new Map(); // values that are not yet sent, with the timers that send them, by their keys

function sendSoon(key, value) {
  if (waitingKnobs.has(key)) clearTimeout(waitingKnobs.get(key).timer);
  waitingKnobs.set(key, { value, timer: setTimeout(() => sendKnob(key), 60) });
}

function sendKnob(key) {
  const { value, timer } = waitingKnobs.get(key);
  clearTimeout(timer);
  waitingKnobs.delete(key);
  post("set", { key, value });
}

// Sends what has been set, and waits until all that has been changed is known to the studio.
async function allIsSet() {
  for (const key of [...waitingKnobs.keys()]) sendKnob(key);
  await Promise.all([...underway]);
}

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
    sendSoon(knob.key, asked());
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
    const name = goal.key === "style" ? goal.goal.split("/").pop() : goal.goal.replace(/^inception_/, "");
    chip.append(element("span", `${goal.key} ${name}`, { title: goal.goal }), remove);
    return chip;
  });
  for (const key of state.other_goals) goals.push(element("span", `${key} of the recipe`, { className: "goal" }));
  $("goals").replaceChildren(...(goals.length ? goals : [element("small", "choose motifs on the left")]));
  for (const id of ["try", "render"]) $(id).disabled = !goals.length || !state.opened || $(id).dataset.busy === "yes";
}
