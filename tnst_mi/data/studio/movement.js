"use strict";

// v* over the picture: as arrows, and the scale of these and of the colours of its depth.

const LONGEST = 1.6; // of usual arrows, in spacings of their lattice
const FACTORS = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100]; // by which they are drawn longer

let movement = null; // as the server tells it, for a picture of so many columns

// Cuts have no arrows.
function movedAs() {
  const chosen = $("moved-as").value;
  return chosen === "arrows" && $("cut").value !== "none" ? "movement" : chosen;
}

function movementSide() {
  return movedAs() === "arrows" ? "after" : movedAs();
}

async function askMovement(of) {
  if (movedAs() === "movement") return;
  of.set("cut", "none");
  movement = { ...await got(`arrows?${of}`), columns: Number(of.get("columns")) };
}

function shownMovement() {
  const moves = mode === "movement" && isStylized();
  $("moved-as").hidden = !moves;
  $("wheel").hidden = !moves || movedAs() !== "movement";
  $("scale").hidden = !moves || movedAs() === "movement";
}

function drawMovement(pen, width, height) {
  if (!movement || movedAs() === "movement") return;
  const mark = $("scale-mark"), scale = mark.getContext("2d"), usual = movement.usual;
  scale.clearRect(0, 0, mark.width, mark.height);
  if (movedAs() === "depth") {
    const colours = scale.createLinearGradient(0, 0, mark.width, 0);
    for (const [place, colour] of [[0, "#2680ff"], [0.5, "#fff"], [1, "#ff8c1a"]]) colours.addColorStop(place, colour);
    scale.fillStyle = colours;
    scale.fillRect(0, 2, mark.width, 10);
    $("scale-text").textContent = `−${told3(usual)} away · +${told3(usual)} cells towards you`;
    return;
  }
  const shown = width / movement.columns, length = usual * movement.cell * shown;
  const factor = FACTORS.findLast((one) => one * length <= LONGEST * movement.spacing * shown) || 1;
  pen.fillStyle = "#0007"; // arrows stand out from bright smoke
  pen.fillRect(0, 0, width, height);
  for (const [x, y, right, up] of movement.arrows) {
    arrow(pen, x * shown, y * shown, factor * right * shown, -factor * up * shown);
  }
  arrow(scale, mark.width - 2 - Math.min(factor * length, 110), 7, Math.min(factor * length, 110), 0);
  $("scale-text").textContent = `${told3(usual)} cells` + (factor === 1 ? "" : `, drawn ${factor} times as long`);
}

function told3(value) {
  return Number(value.toPrecision(2));
}

function arrow(pen, x, y, right, down) {
  const length = Math.hypot(right, down);
  if (length < 1) return;
  const head = Math.min(5, 0.5 * length), [a, b] = [right / length, down / length], tip = [x + right, y + down];
  const neck = [tip[0] - head * a, tip[1] - head * b];
  pen.lineWidth = 1.5;
  pen.strokeStyle = pen.fillStyle = "#ffd28a";
  pen.beginPath();
  pen.moveTo(x, y);
  pen.lineTo(...neck);
  pen.stroke();
  pen.beginPath();
  pen.moveTo(...tip);
  pen.lineTo(neck[0] - 0.6 * head * b, neck[1] + 0.6 * head * a);
  pen.lineTo(neck[0] + 0.6 * head * b, neck[1] - 0.6 * head * a);
  pen.fill();
}
