// A button on each block of code that copies its commands without prompt and output.
document.addEventListener("DOMContentLoaded", () => {
  if (!navigator.clipboard) return;
  for (const block of document.querySelectorAll("div.highlight > pre")) {
    const button = document.createElement("button");
    button.className = "copy";
    button.textContent = "Copy";
    button.addEventListener("click", async () => {
      const text = block.textContent;
      const commands = [];
      let continued = false;
      for (const line of text.split("\n")) {
        const command = continued || line.startsWith("$ ") || line.startsWith("> ");
        if (command) commands.push(line.replace(/^[$>] /, ""));
        continued = command && line.endsWith("\\");
      }
      await navigator.clipboard.writeText(commands.join("\n") || text);
      button.textContent = "Copied";
      setTimeout(() => { button.textContent = "Copy"; }, 1500);
    });
    block.parentElement.style.position = "relative";
    block.parentElement.append(button);
  }
});
