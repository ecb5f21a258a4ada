"use strict";

// The recipe: goals, and sliders for its keys.

const rows = {};
const waitingKnobs = new Map(); // values that are not yet sent, with the timers that send them, by their keys
const sentKnobs = new Map(); // promises of the latest answers that are awaited, by their keys
const answeredKnobs = new Map(); // versions of the state that were known when the latest answers came, by their keys

function sendSoon(key, value) {
  if (waitingKnobs.has(key)) clearTimeout(waitingKnobs.get(key).timer);
  waitingKnobs.set(key, { value, timer: setTimeout(() => sendKnob(key), 60) });
}

function sendKnob(key) {
  setKnob(key, waitingKnobs.get(key).value);
}

// Sets a key after what is being set of it, and instead of what waits.
function setKnob(key, value) {
  if (waitingKnobs.has(key)) clearTimeout(waitingKnobs.get(key).timer);
  waitingKnobs.delete(key);
  const before = sentKnobs.get(key);
  const send = async () => {
    await before;
    const accepted = await posted("set", { key, value });
    if (sentKnobs.get(key) !== asked) return true; // another value has followed, which counts
    sentKnobs.delete(key);
    if (accepted) answeredKnobs.set(key, state.version); else showRecipe();
    return accepted;
  };
  const asked = change(send());
  sentKnobs.set(key, asked);
}

// Whether what the studio tells of a key may be older than what has been set here.
function isNewerHere(key) {
  return waitingKnobs.has(key) || sentKnobs.has(key) || answeredKnobs.get(key) === state.version;
}

// Sends what has been set, and waits until all changes are made or refused; whether all have been made, those too that
// the press of the present button has begun by leaving a field.
async function allIsSet() {
  let all = refusals === refusalsBefore;
  while (waitingKnobs.size || underway.size) {
    for (const key of [...waitingKnobs.keys()]) sendKnob(key);
    all = (await Promise.all([...underway])).every(Boolean) && all;
  }
  return all;
}

// The row of a key with something that sets it, and its parts: name, help and what takes the value back.
function rowOf(knob, control) {
  const row = element("div", undefined, { className: "knob" });
  const name = element("button", knob.key, { title: `${knob.label}: ${knob.help}`, className: "key" });
  const help = element("p", `${knob.help} (${knob.expected})`, { hidden: true });
  control.setAttribute("aria-label", knob.label);
  name.addEventListener("click", () => {
    help.hidden = !help.hidden;
    row.scrollIntoView({ block: "nearest" });
  });
  const back = element("button", "↺", { title: "as it was" });
  back.addEventListener("click", () => setKnob(knob.key, null));
  row.append(name, control, back, help);
  $("knobs").append(row);
  return { row, back };
}

function pickRow(pick) {
  const select = element("select", undefined, { id: `knob-${pick.key}` });
  select.append(...pick.words.map((word) => element("option", word, { value: word })));
  select.addEventListener("change", () => setKnob(pick.key, select.value));
  return { ...rowOf(pick, select), control: select };
}

function knobRow(knob) {
  const value = element("output"), slider = element("input", undefined, { type: "range", id: `knob-${knob.key}` });
  const ends = knob.logarithmic ? [Math.log10(knob.low), Math.log10(knob.high)] : [knob.low, knob.high];
  [slider.min, slider.max] = ends;
  slider.step = knob.step;
  const asked = () => Number((knob.logarithmic ? 10 ** slider.value : Number(slider.value)).toPrecision(3));
  slider.addEventListener("input", () => {
    value.textContent = asked();
    sendSoon(knob.key, asked());
  });
  const word = element("button", knob.word || "", { title: `${knob.key} = "${knob.word}"`, hidden: !knob.word });
  word.addEventListener("click", () => setKnob(knob.key, knob.word));
  const { row, back } = rowOf(knob, slider);
  slider.after(value, word);
  return { row, slider, value, word, back };
}

function showPicks() {
  for (const pick of state.picks) {
    const { row, control, back } = rows[pick.key] = rows[pick.key] || pickRow(pick);
    row.classList.toggle("set", pick.set);
    control.disabled = back.disabled = Boolean(state.start) && !pick.free;
    control.title = control.disabled ? "stays as it was in what is gone on from" : "";
    back.hidden = !pick.set;
    if (!isNewerHere(pick.key)) control.value = pick.value;
  }
}

function showRecipe() {
  for (const knob of state.knobs) {
    const { row, slider, value, word, back } = rows[knob.key] = rows[knob.key] || knobRow(knob);
    row.classList.toggle("set", knob.set);
    slider.disabled = word.disabled = back.disabled = Boolean(state.start) && !knob.free;
    slider.title = slider.disabled ? "stays as it was in what is gone on from" : "";
    back.hidden = !knob.set;
    if (isNewerHere(knob.key) || (document.activeElement === slider && slider.matches(":active"))) continue;
    value.textContent = knob.keyframed ? "changes over the frames" : knob.value;
    if (typeof knob.value === "number") slider.value = knob.logarithmic ? Math.log10(knob.value) : knob.value;
  }
  showPicks();
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
