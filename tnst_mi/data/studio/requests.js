"use strict";

// What the page asks the studio for, and elements that it makes of the answers. The other scripts need it.

let state = null; // what all tabs share, as the server tells it
const $ = (id) => document.getElementById(id);

// Says something in the place of its source, where it stays until that has something else to say, or it is closed:
// "error" of what is asked for, "cluster-error" of the address of a cluster, "view-error" of pictures, "place-error" of
// where frames lie, "notice" of what the studio could not show, "notes" of what is opened, "kept" of paintings, "remark"
// of settings that stay.
function complain(text, source = "error", path = "") {
  const shown = $(source);
  shown.dataset.path = path;
  if (!shown.firstChild) {
    const close = element("button", "×", { title: "close" });
    close.addEventListener("click", () => { shown.hidden = true; });
    shown.append(element("span"), close);
  }
  shown.firstChild.textContent = text || "";
  shown.hidden = !text;
}

async function answered(response) {
  if (response.ok) return response;
  let text = `${response.status}`;
  try { text = (await response.json()).error; } catch { /* not ours: the status has to do */ }
  throw new Error(text);
}

const underway = new Set(); // changes that are not over yet: promises, never broken, of whether they have been made

// Counts a change with all its steps as under way until it is over.
function change(made) {
  underway.add(made);
  made.finally(() => underway.delete(made));
  return made;
}

function post(path, values) {
  return change(posted(path, values));
}

async function posted(path, values, source = "error") {
  return sent(path, { headers: { "Content-Type": "application/json" }, body: JSON.stringify(values) }, source);
}

let refusals = 0, refusalsBefore = 0; // of changes: so far, and until a button or key was pressed last

for (const press of ["pointerdown", "keydown"]) document.addEventListener(press, () => { refusalsBefore = refusals; }, true);

// Whether what has been sent is done. If not, why is said until it is closed, or the like is done that was asked for later:
// neither what was asked for at the same time nor what is done next hides it.
async function sent(path, what, source = "error") {
  const before = refusals;
  try {
    await answered(await fetch(path, { method: "POST", ...what }));
    const said = $(source).dataset.path;
    if (refusals === before && (!said || said === path.split("?")[0])) complain("", source);
    return true;
  } catch (error) {
    if (source === "error") refusals += 1;
    complain(error.message, source, path.split("?")[0]);
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
