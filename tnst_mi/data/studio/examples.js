"use strict";

// Pictures of tags and channels that have none, made when they are asked for and shown as they come.

const LOOK_AGAIN = 2000; // milliseconds

function withoutPicture() {
  return motifs.filter((motif) => motif.key !== "style" && !motif.thumbnail);
}

function showExamples() {
  const bare = withoutPicture(), button = $("examples");
  button.hidden = !bare.length;
  if (button.disabled) return;
  button.textContent = bare.length === 1 ? "show what it looks like" : `show what these ${bare.length} look like`;
}

async function followExamples() {
  $("examples").disabled = true;
  try {
    for (let busy = true; busy;) {
      await new Promise((resolve) => setTimeout(resolve, LOOK_AGAIN));
      const told = await got("examples");
      busy = told.busy;
      await find();
      $("examples").textContent = `making pictures, ${withoutPicture().length} to go`;
      if (told.error) complain(told.error);
    }
  } catch (error) {
    complain(error.message);
  }
  $("examples").disabled = false;
  showExamples();
}

$("examples").addEventListener("click", async () => {
  const goals = withoutPicture().map((motif) => [motif.key, motif.goal]);
  if (await post("examples", { goals })) followExamples();
});
