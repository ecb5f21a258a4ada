"use strict";

// What the page asks the studio for, and elements that it makes of the answers. The other scripts need it.

let state = null; // what all tabs share, as the server tells it
const $ = (id) => document.getElementById(id);

// Says something in the place of its source, where it stays until that has something else to say, or it is closed:
// "error" of what is asked for, "view-error" of pictures, "place-error" of where frames lie, "notes" of what is opened,
// "kept" of paintings.
function complain(text, source = "error") {
  const shown = $(source);
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

const underway = new Set(); // changes that have not been answered yet

function post(path, values) {
  const asked = posted(path, values);
  underway.add(asked);
  asked.finally(() => underway.delete(asked));
  return asked;
}

async function posted(path, values) {
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
