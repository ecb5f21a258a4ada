"use strict";

// What the page asks the studio for, and elements that it makes of the answers. The other scripts need it.

let state = null; // what all tabs share, as the server tells it
const $ = (id) => document.getElementById(id);

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
