import { ask, element, say, trying } from "./lab.js";
import { CloudView, drawProfile, pointsIn } from "./drawing.js";
import { watchPictures } from "./pictures.js";

const bench = element("bench").dataset;
const UNDER_WAY = ["running", "pausing", "paused"];
const NAMES = { check: "Check of the devices", home: "Reset of the motor", move: "Move", shoot: "Step and shoot", scan: "Scan", calibrate: "Calibration" };
// How long an order to take a photograph may be on its way before it can be given again.
const ANSWER_MS = 3000;
const EDGES = ["upper", "lower", "left", "right"];
const cloud = new CloudView(element("cloud"));
let state = null, cloudOf = "", shown = null, lastProfile = null, slides = false, focused = null, rigs = [], answered = null;

const mine = () => state?.operator?.seat === bench.seat;

// --- what is seen -------------------------------------------------------------------------------------------------

function showState(now) {
  const before = state;
  state = now;
  if (!before) {
    limitAxis();
    showBatch();
  }
  const { operator, job } = now, { place } = now.axes[moved()];
  const own = mine(), named = operator?.name === bench.name;
  const words = element("operator");
  words.textContent = own ? "You operate the scanner" : operator
    ? `${named ? "You operate it from another place" : `${operator.name} operates`}. Here you watch` : "The scanner is free";
  words.className = `operator ${own ? "mine" : operator ? "theirs" : ""}`;
  element("take").hidden = Boolean(operator);
  element("leave").hidden = !own;
  element("take-over").hidden = !operator || own || !(named || bench.administrator === "true");
  element("stop").hidden = !own && bench.administrator !== "true";
  showControls(own, Boolean(job) && UNDER_WAY.includes(job.state));
  showRig(before, now, own);
  element("place").textContent = place === null ? "an unknown place: it is homed before it moves" : `${place} steps`;
  if (place !== null && !slides && !own) setPlace(place);
  showRest();
  element("live").checked = now.live;
  element("live-laser").checked = now.live_laser;
  showJob(job, own);
  showGuide(now.guide, own);
  // What was said of an order is over once something comes of it.
  const course = job && `${job.id} ${job.state}`;
  if (course !== shown && !element("said").classList.contains("problem")) say("");
  shown = course;
}

// What had the keyboard last: a control that is disabled loses it.
addEventListener("focusin", ({ target }) => { focused = target; });

/** Controls rest while a job runs; whatever had the keyboard then has it again afterwards. */
function showControls(own, busy) {
  for (const part of document.querySelectorAll("[data-operator]")) {
    const rested = part.disabled;
    part.disabled = !own || (busy && part.dataset.always === undefined);
    if (rested && !part.disabled && document.activeElement === document.body && part.contains(focused)) focused.focus();
  }
}

/** The rig in use, and what can be calibrated or taken into use. */
function showRig(before, now, own) {
  element("rig-name").textContent = now.rig ? now.rig_name || "the server's own" : "none";
  element("cloud-card").hidden = !now.rig;
  element("no-rig").hidden = now.rig;
  element("rig-warnings").replaceChildren(...now.rig_warnings.map((warning) => line("p", `The rig's file warns: ${warning}.`, "hint")));
  const done = before && before.job?.state !== now.job?.state && now.job?.work.kind === "calibrate";
  const other = before && (before.rig !== now.rig || before.rig_name !== now.rig_name);
  if (other) { cloudOf = ""; cloud.replace([]); element("no-cloud").hidden = false; element("cloud-of").textContent = ""; }
  if (own && (!before || before.operator?.seat !== bench.seat || done || other)) loadRigs().catch((error) => say(error.message, true));
}

function line(kind, words, style = "") {
  const made = document.createElement(kind);
  made.textContent = words;
  made.className = style;
  return made;
}

/** What a list offers; what was chosen stays chosen, and `none` is said where it is empty. */
function offer(id, named, none) {
  const list = element(id), chosen = list.value;
  list.replaceChildren(...named.map(([value, words]) => Object.assign(line("option", words), { value })));
  if (named.some(([value]) => value === chosen)) list.value = chosen;
  if (!named.length) list.replaceChildren(Object.assign(line("option", none), { value: "", disabled: true, selected: true }));
}

async function loadRigs(chosen) {
  const [sessions, found] = await Promise.all([ask("GET", "/api/calibrations"), ask("GET", "/api/rigs")]);
  rigs = found;
  offer("session", sessions.filter((one) => !one.problem).map((one) => [one.name, `${one.name}: ${one.views} poses`]), "none yet: take a calibration session");
  offer("rig", rigs.map((one) => [one.name, `${one.name || "the server's own"}${one.in_use ? " (in use)" : ""}`]), "none yet: calibrate a session");
  if (chosen !== undefined) element("rig").value = chosen;
  element("solve").disabled = !sessions.some((one) => !one.problem);
  showVerdict();
}

function showVerdict() {
  const one = rigs.find((rig) => rig.name === element("rig").value);
  element("verdict").replaceChildren(...(one?.verdict ?? []).map((words) => line("li", words)));
  element("use").disabled = !one || one.in_use;
}

function showJob(job, own) {
  element("job").hidden = !job;
  if (!job) return;
  const { work } = job, under = UNDER_WAY.includes(job.state), scan = work.kind === "scan";
  const counts = scan || work.kind === "calibrate";
  element("job-title").textContent = [NAMES[work.kind], work.project ?? work.session, work.kind === "move" && `to ${work.step}`, work.axis && several() && `(${work.axis})`].filter(Boolean).join(" ");
  element("job-state").textContent = job.state;
  element("job-state").className = `badge ${job.state}`;
  element("job-progress").hidden = !counts;
  element("job-progress").max = Math.max(job.total, 1);
  element("job-progress").value = job.taken;
  const count = counts ? `${job.taken} of ${job.total} photographs` : "";
  element("job-words").textContent = [count, job.message, `ordered by ${job.user}`].filter(Boolean).join(" · ");
  element("job-words").classList.toggle("problem", job.state === "failed");
  element("pause").hidden = !(own && scan && job.state === "running");
  element("resume").hidden = !(own && scan && ["pausing", "paused", "aborted", "failed", "interrupted"].includes(job.state));
  element("abort").hidden = !(own && under);
}

/** What a calibration session asks for now, "" for nothing. */
const asked = (guide) => (guide?.wish ? `${guide.views} ${guide.wish}` : "");

/** What a calibration session asks for, and what it has seen so far. */
function showGuide(guide, own) {
  const asks = Boolean(guide?.wish), seen = guide?.board_seen ? "board seen" : "board not seen";
  element("wish").hidden = !asks;
  element("wish").textContent = asks ? guide.wish : "";
  element("covered").hidden = !guide;
  if (guide) {
    const cells = guide.covered.flat(), edges = EDGES.map((edge) => `${guide.tilted[edge] ? "✓" : "–"} ${edge}`).join(", ");
    element("covered").textContent = `${seen} · corners in ${cells.filter(Boolean).length} of ${cells.length} parts of the image · tilted: ${edges}`;
    element("covered").classList.toggle("seen", guide.board_seen);
  }
  const comes = own && asks && element("take-view").hidden, held = !guide?.on_axis;
  element("take-view").hidden = !(own && asks);
  element("take-view").disabled = asked(guide) === answered;
  element("take-view").textContent = held ? "Take" : `Begin the ${guide.on_axis}'s sequence`;
  element("enough").hidden = !(own && asks && guide.views >= 3);
  element("enough").textContent = held ? "Enough poses" : `No ${guide.on_axis}`;
  // Whoever holds the board has one hand: Enter or the space bar takes the next view too.
  if (comes && !document.activeElement.matches("input")) element("take-view").focus();
}

async function showProfile(profile) {
  lastProfile = profile;
  drawProfile(element("profile"), profile);
  element("no-profile").hidden = true;
  element("profile-of").textContent = `${profile.project}, photograph ${profile.number}, ${profile.place}`;
  if (profile.problem) element("cloud-of").textContent = profile.problem;
  element("cloud-of").classList.toggle("problem", Boolean(profile.problem));
  if (!profile.points) return;
  const added = profile.project === cloudOf && cloud.length + profile.points.length === profile.cloud_points;
  if (added) cloud.add(profile.points);
  else await loadCloud(profile.project);
  element("cloud-of").textContent = `${profile.project}: ${cloud.length}`;
  element("no-cloud").hidden = cloud.length > 0;
}

addEventListener("resize", () => { if (lastProfile) drawProfile(element("profile"), lastProfile); });

/** All points so far, where some were missed. */
async function loadCloud(project) {
  cloudOf = project;
  const answer = await fetch("/api/cloud");
  if (!answer.ok) return;
  cloud.replace(pointsIn(await answer.arrayBuffer()));
}

// --- streams ------------------------------------------------------------------------------------------------------

const picture = element("picture");
let events = null, pictures = null;

function connect() {
  if (events) return;
  events = new EventSource("/api/events");
  events.addEventListener("state", (event) => showState(JSON.parse(event.data)));
  events.addEventListener("profile", (event) => showProfile(JSON.parse(event.data)).catch(() => {}));
  // The server asks whether the operator is there; timers of a hidden page would be too slow.
  events.addEventListener("ping", () => { if (mine()) ask("PUT", "/api/lock").catch((error) => say(error.message, true)); });
  events.addEventListener("open", () => {
    if (element("said").textContent.includes("server")) say("");
    pictures?.abort();
    pictures = new AbortController();
    // It ends with the connection, and begins with the next one.
    watchPictures("/api/pictures", pictures.signal, showPicture).catch(() => {});
  });
  events.addEventListener("error", () => {
    say("the connection to the server is lost, trying again …", true);
    // A session that has ended is not seen by an EventSource.
    ask("GET", "/api/me").catch(() => {});
  });
}

function showPicture(bytes) {
  const before = picture.src;
  picture.src = URL.createObjectURL(new Blob([bytes], { type: "image/jpeg" }));
  picture.hidden = false;
  element("no-picture").hidden = true;
  if (before) URL.revokeObjectURL(before);
}

function disconnect() {
  events?.close();
  events = null;
  pictures?.abort();
}

// A hidden page that only watches costs nothing, and leaves its connections to others.
document.addEventListener("visibilitychange", () => { if (!document.hidden) connect(); else if (!mine()) disconnect(); });
addEventListener("pagehide", disconnect);
// After the page has loaded: it would wait for the streams' end.
addEventListener("pageshow", connect);

// --- orders -------------------------------------------------------------------------------------------------------

const several = () => Object.keys(state.axes).length > 1;
/** The axis that moves by hand, and the one along which a batch is taken. */
const moved = () => element("axis").value;
const batch = element("batch").elements;
const others = [...document.querySelectorAll("[data-at]")];

function limit(field, { first, last }) {
  field.min = first;
  field.max = last;
}

/** The slider goes over the whole of the axis in round steps. */
function limitAxis() {
  const axis = state.axes[moved()];
  for (const id of ["slider", "step"]) limit(element(id), axis);
  element("slider").step = Math.min(100, 10 ** Math.max(0, Math.floor(Math.log10((axis.last - axis.first) / 100))));
}

function showAxis() {
  limitAxis();
  const { place, first } = state.axes[moved()];
  setPlace(place ?? first);
  showState(state);
}

/** The fields of a batch along this axis: how far the photographs are apart, and where the others stand. */
function showBatch() {
  const axis = state.axes[batch.axis.value], turns = axis.steps_per_turn !== null;
  limit(batch.first, axis);
  batch.first.value = axis.first;
  element("full-turn").hidden = !turns;
  batch.full_turn.checked = turns;
  if (turns) batch.frames.value = Math.min(axis.steps_per_turn, 360);
  showApart();
  showRest();
}

function showApart() { batch.apart.disabled = batch.full_turn.checked; }

/** Where the other axes of a batch stand; one of which nobody has said anything stays where it is. */
function showRest() {
  for (const label of others) {
    const field = label.querySelector("input"), { place } = state.axes[label.dataset.at];
    label.hidden = label.dataset.at === batch.axis.value;
    if (!field.dataset.said && document.activeElement !== field) field.value = place ?? "";
  }
}

/** Where other axes than this one stand, as far as it is known. */
function rest(axis) {
  const at = {};
  for (const [name, { place }] of Object.entries(state.axes)) if (name !== axis && place !== null) at[name] = place;
  return at;
}

function setPlace(step) {
  element("slider").value = step;
  element("step").value = step;
}

const chosen = () => Number(element("step").value);
const project = () => {
  const field = element("project");
  if (!field.value || !field.reportValidity()) throw new Error("give the project a name: letters, digits, _ and -");
  return field.value;
};
const onClick = (id, work) => element(id).addEventListener("click", (event) => trying(work, event.currentTarget));
const order = async (work, words) => { await ask("POST", "/api/jobs", work); say(words); };
const change = (action) => async () => { await ask("POST", `/api/jobs/${state.job.id}/${action}`); say(""); };

element("axis").addEventListener("change", showAxis);
batch.axis.addEventListener("change", showBatch);
batch.full_turn.addEventListener("change", showApart);
for (const label of others) label.addEventListener("input", ({ target }) => { target.dataset.said = target.value; });
element("slider").addEventListener("input", () => { slides = true; element("step").value = element("slider").value; });
element("slider").addEventListener("change", () => { slides = false; });
element("step").addEventListener("input", () => { element("slider").value = chosen(); });

onClick("take", async () => { showState(await ask("POST", "/api/lock", {})); say(""); const { place } = state.axes[moved()]; if (place !== null) setPlace(place); });
onClick("take-over", async () => { showState(await ask("POST", "/api/lock", { take_over: true })); say(""); });
onClick("leave", async () => { await ask("DELETE", "/api/lock"); say(""); });
onClick("move", () => order({ kind: "move", axis: moved(), step: chosen() }, "on the way"));
onClick("home", () => order({ kind: "home" }, "to the reference switch, then to step 0"));
onClick("check", () => order({ kind: "check" }, "asking motors and camera"));
onClick("shoot", () => order({ kind: "shoot", project: project(), axis: moved(), step: chosen(), at: rest(moved()) }, "on the way, then a photograph"));
onClick("pause", change("pause"));
onClick("resume", change("resume"));
onClick("abort", change("abort"));

const stop = async () => {
  const { left_on } = await ask("POST", "/api/stop");
  say(left_on || `stopped; ${several() ? "every axis" : `the ${moved()}`} is homed before it moves again`, Boolean(left_on));
};
onClick("stop", stop);
addEventListener("keydown", (event) => { if (event.key === "Escape" && !element("stop").hidden) trying(stop); });

element("batch").addEventListener("submit", (event) => {
  event.preventDefault();
  const fields = new FormData(event.target), number = (name) => Number(fields.get(name));
  const at = {};
  for (const label of others) {
    const field = label.querySelector("input");
    if (!label.hidden && field.value) at[label.dataset.at] = Number(field.value);
  }
  trying(() => order({
    kind: "scan", project: project(), axis: fields.get("axis"), at, frames: number("frames"),
    apart: fields.has("full_turn") ? null : number("apart"), first: number("first"), settle_s: number("settle_s"), dark: fields.has("dark"),
  }, "the devices are asked first, then it begins"), event.submitter);
});

element("calibration").addEventListener("submit", (event) => {
  event.preventDefault();
  const fields = Object.fromEntries(new FormData(event.target)), { session, ...numbers } = fields;
  for (const name in numbers) numbers[name] = Number(numbers[name]);
  trying(() => order({ kind: "calibrate", session, ...numbers }, "the devices are connected, then it begins"), event.submitter);
});
onClick("solve", async () => {
  const session = element("session").value;
  element("solving").textContent = `calibrating ${session}: a minute or two; nothing moves`;
  try {
    const made = await ask("POST", `/api/calibrations/${session}/rig`);
    await loadRigs(made.name);
    say(`${session} is calibrated: read the verdict, then use this rig`);
  } finally {
    element("solving").textContent = "a minute or two; nothing moves";
  }
});
element("rig").addEventListener("change", showVerdict);
// Here trying() would enable the button of what is in use already.
element("use").addEventListener("click", () => trying(async () => {
  showState(await ask("PUT", "/api/rig", { name: element("rig").value }));
  await loadRigs();
  say("From now on points are computed with this rig");
}));
onClick("take-view", async () => {
  // Until the answer is seen here, the same wish would be answered twice.
  const answering = (wish) => { answered = wish; showGuide(state.guide, mine()); };
  answering(asked(state.guide));
  setTimeout(() => answering(null), ANSWER_MS);
  try { await change("take")(); } catch (error) { answering(null); throw error; }
});
onClick("enough", change("enough"));

for (const id of ["live", "live-laser"])
  element(id).addEventListener("change", () =>
    trying(() => ask("PUT", "/api/live", { on: element("live").checked, laser: element("live-laser").checked })));
