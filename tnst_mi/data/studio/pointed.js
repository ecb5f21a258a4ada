"use strict";

// The buttons of tries and renders move when something is begun, ends or is chosen. A click on one that has just come to
// lie under a pointer at rest was meant for what was there before.

const JUST_COME = 400; // milliseconds

let pointer = [-1, -1], pointed = null, cameAt = -Infinity; // where it is, on which button, and since when that lies there

// Notes which button is under the pointer: whether that has come to it, or it to the button.
function findPointed(pointerMoved = false) {
  const there = document.elementFromPoint(...pointer);
  const button = there && there.closest("#making button, #making img");
  if (button === pointed) return;
  pointed = button;
  cameAt = pointerMoved ? -Infinity : performance.now();
}

for (const moved of ["pointermove", "pointerdown"]) {
  document.addEventListener(moved, (event) => {
    if (event.clientX === pointer[0] && event.clientY === pointer[1]) return; // what is under it has moved
    pointer = [event.clientX, event.clientY];
    findPointed(true);
  }, true);
}
$("work").addEventListener("wheel", () => requestAnimationFrame(() => findPointed(true)), { passive: true });
$("work").addEventListener("load", () => findPointed(), true); // pictures have no height before
// Both lists: that of settings, above, pushes this one down.
new MutationObserver(() => findPointed()).observe($("right"), {
  subtree: true, childList: true, attributeFilter: ["hidden", "class"],
});

document.addEventListener("click", (event) => {
  const byPointer = event.detail > 0, just = performance.now() - cameAt < JUST_COME;
  if (!byPointer || !just || !pointed || !pointed.contains(event.target)) return;
  event.preventDefault();
  event.stopPropagation();
}, true);
