// A project's points: a click on a face measures it, and what is between it and another.

import { CloudView, pointsIn } from "./drawing.js";
import { ask, element, say, trying } from "./lab.js";

const { project } = element("measure").dataset, path = `/api/projects/${project}`;
const cloud = new CloudView(element("points"), clicked);
let faces = [], found = null, measuring = false;

await trying(async () => {
  const answer = await points();
  cloud.replace(pointsIn(await answer.arrayBuffer()));
  element("waiting").hidden = true;
  element("radius").value = Number((0.05 * cloud.size).toPrecision(1));
});

/** The points, asked for again while others are computed first. */
async function points() {
  const waiting = element("waiting"), computing = waiting.textContent;
  for (;;) {
    const answer = await fetch(`${path}/points`);
    if (answer.ok) return answer;
    const { detail } = await answer.json();
    const again = Number(answer.headers.get("Retry-After"));
    if (!again) {
      waiting.hidden = true;
      throw new Error(detail);
    }
    waiting.textContent = `Waiting: ${detail}.`;
    await new Promise((resolve) => setTimeout(resolve, 1000 * again));
    waiting.textContent = computing;
  }
}

async function clicked(place) {
  if (measuring || !element("radius").reportValidity()) return;
  const from = element("from").value;
  const before = faces.length ? faces.length - 1 : null;
  const measured_from = from === "" ? before : from === "none" ? null : Number(from);
  await measure([...faces, {
    kind: element("kind").value, place: [...place], radius: Number(element("radius").value), grow: element("grow").checked, measured_from,
  }]);
}

/** Measure these; a click that gives no face is not kept, and the reason is said. */
async function measure(asked) {
  measuring = true;
  say("measuring …");
  await trying(async () => {
    const answer = await ask("POST", `${path}/measure`, { faces: asked });
    const wrong = answer.faces.findLast((face) => face.problem);
    if (wrong) throw new Error(`${wrong.name}: ${wrong.problem}`);
    [faces, found] = [asked, answer];
    show();
    say("");
  });
  measuring = false;
}

function show() {
  element("found").hidden = !faces.length;
  const lines = found.faces.map((face) => [face.name, `${face.count} points, ${face.left_out} left out`]);
  lines.push(...found.dimensions.map((one) => [one.name, one.words]));
  element("rows").replaceChildren(...lines.map((cells) => {
    const row = document.createElement("tr");
    row.append(...cells.map((words, column) => Object.assign(document.createElement(column ? "td" : "th"), { textContent: words })));
    return row;
  }));
  element("notes").replaceChildren(...found.notes.map((note) => Object.assign(document.createElement("p"), { className: "hint", textContent: note })));
  const kept = element("from").value;
  element("from").replaceChildren(new Option("the one before", ""), new Option("none", "none"), ...found.faces.map((face, i) => new Option(face.name, i)));
  element("from").value = [...element("from").options].some((one) => one.value === kept) ? kept : "";
  cloud.mark(found.faces.map((face) => ({ name: face.name, points: face.points })));
}

element("undo").addEventListener("click", () => { if (!measuring) measure(faces.slice(0, -1)); });
element("save").addEventListener("click", () => {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([found.part], { type: "application/toml" }));
  link.download = "part.toml";
  link.click();
  URL.revokeObjectURL(link.href);
});
