// A button on each block of code that copies its commands without prompt and output.
document.addEventListener("DOMContentLoaded", () => {
  if (!navigator.clipboard) return;
  for (const block of document.querySelectorAll("div.highlight > pre")) {
    const button = document.createElement("button");
    button.className = "copy";
    button.textContent = "Copy";
    button.addEventListener("click", async () => {
      const text = block.textContent;
      const commands = text.split("\n").filter((line) => line.startsWith("$ "));
      await navigator.clipboard.writeText(
        commands.length ? commands.map((line) => line.slice(2)).join("\n") : text,
      );
      button.textContent = "Copied";
      setTimeout(() => { button.textContent = "Copy"; }, 1500);
    });
    block.parentElement.style.position = "relative";
    block.parentElement.append(button);
  }
});
