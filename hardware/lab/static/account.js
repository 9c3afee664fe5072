import { ask, element, trying } from "./lab.js";

element("make").addEventListener("submit", (event) => {
  event.preventDefault();
  trying(async () => {
    const { token } = await ask("POST", "/api/tokens", { name: new FormData(event.target).get("name") });
    element("token").textContent = token;
    element("made").hidden = false;
    event.target.reset();
  });
});

for (const button of document.querySelectorAll("[data-drop]"))
  button.addEventListener("click", () =>
    trying(async () => {
      await ask("DELETE", `/api/tokens/${button.dataset.drop}`);
      button.closest("li").remove();
    }, button),
  );
