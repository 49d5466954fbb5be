// A button on each block of code that copies it: of a session its input only.
function program(text) {
  const lines = text.split("\n");
  if (!lines.some((line) => /^>>>/.test(line))) return text;
  return lines.filter((line) => /^(>>>|\.\.\.)/.test(line)).map((line) => line.slice(4)).join("\n");
}

document.addEventListener("DOMContentLoaded", () => {
  if (!navigator.clipboard) return;
  for (const block of document.querySelectorAll("div.highlight")) {
    if (block.closest(".sphx-glr-script-out")) continue; // what a program prints
    const button = document.createElement("button");
    button.className = "copy";
    button.type = "button";
    button.textContent = "Copy";
    button.addEventListener("click", async () => {
      await navigator.clipboard.writeText(program(block.querySelector("pre").textContent));
      button.textContent = "Copied";
      setTimeout(() => (button.textContent = "Copy"), 1500);
    });
    block.append(button);
  }
});

// Figures of several panels keep a width at which their letters can be read, and scroll on a phone.
window.addEventListener("load", () => {
  for (const figure of document.querySelectorAll(".bd-article img")) {
    if (figure.naturalWidth < 1400 || figure.closest("a, .wide")) continue;
    const frame = document.createElement("div");
    frame.className = "wide";
    figure.replaceWith(frame);
    frame.append(figure);
  }
});
