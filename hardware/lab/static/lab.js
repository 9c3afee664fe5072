// What all pages share: requests, and words for the reader.

const csrf = document.querySelector("meta[name=csrf]")?.content;

export const element = (id) => document.getElementById(id);

/** Ask the lab; an answer that is a refusal is thrown in its own words. */
export async function ask(method, path, body) {
  const headers = method === "GET" ? {} : { "X-CSRF-Token": csrf };
  if (body !== undefined) headers["Content-Type"] = "application/json";
  let answer;
  try {
    answer = await fetch(path, { method, headers, body: body === undefined ? undefined : JSON.stringify(body) });
  } catch {
    throw new Error("the server does not answer");
  }
  if (answer.status === 401) location.assign("/sign-in");
  const text = await answer.text();
  const data = text ? JSON.parse(text) : null;
  if (!answer.ok) throw new Error(inWords(data?.detail) || `the server answered ${answer.status}`);
  return data;
}

/** Refusals are sentences; what is wrong with a form comes as a list. */
function inWords(detail) {
  if (!Array.isArray(detail)) return detail;
  return detail.map((one) => `${one.loc.at(-1)}: ${one.msg}`).join("; ");
}

export function say(words, problem = false) {
  const said = element("said");
  said.textContent = words;
  said.classList.toggle("problem", problem);
}

/** Run what a button does; while it runs the button rests, and a refusal is said. */
export async function trying(work, button) {
  if (button) button.disabled = true;
  try {
    await work();
  } catch (error) {
    say(error.message, true);
  } finally {
    if (button) button.disabled = false;
  }
}

for (const time of document.querySelectorAll("time[data-time]"))
  time.textContent = new Date(1000 * time.dataset.time).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
