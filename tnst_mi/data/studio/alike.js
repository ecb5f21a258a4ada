"use strict";

// Motifs in the order in which the network answers to a picture, in place of those that are found by their names alone.

let sample = null; // the picture

async function alike() {
  const of = new URLSearchParams({ name: sample.name, find: $("find").value });
  return (await answered(await fetch(`alike?${of}`, { method: "POST", body: sample }))).json();
}

async function compareWith(file) {
  sample = file;
  $("sample").hidden = false;
  URL.revokeObjectURL($("sample-picture").src);
  $("sample-picture").src = URL.createObjectURL(file);
  $("sample-name").textContent = `like ${file.name}`;
  finder = alike;
  if (!(await find())) byNameAgain();
}

function byNameAgain() {
  sample = null;
  finder = byName;
  $("sample").hidden = true;
  find();
}

$("by-picture").addEventListener("click", () => $("compared").click());
$("compared").addEventListener("change", (event) => {
  const [file] = event.target.files;
  if (file) compareWith(file);
  event.target.value = "";
});
$("sample-end").addEventListener("click", () => { complain(""); byNameAgain(); });
$("search").addEventListener("drop", (event) => {
  event.preventDefault();
  event.stopPropagation(); // elsewhere, pictures become styles
  document.body.classList.remove("dropping");
  const [file] = event.dataTransfer.files;
  if (file) compareWith(file);
});
