import { ask, say, trying } from "./lab.js";

for (const button of document.querySelectorAll("[data-remove]"))
  button.addEventListener("click", () => {
    const name = button.dataset.remove;
    if (!confirm(`Remove project ${name} with all its photographs?`)) return;
    trying(async () => {
      await ask("DELETE", `/api/projects/${name}`);
      document.querySelector(`[data-project="${name}"]`).remove();
      say(`${name} is removed`);
    }, button);
  });
