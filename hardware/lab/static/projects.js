import { ask, say, trying } from "./lab.js";

for (const button of document.querySelectorAll("[data-remove]"))
  button.addEventListener("click", () => {
    const { name, remove } = button.dataset;
    if (!confirm(`Remove ${name} with all its photographs?`)) return;
    trying(async () => {
      await ask("DELETE", remove);
      button.closest("li").remove();
      say(`${name} is removed`);
    }, button);
  });
