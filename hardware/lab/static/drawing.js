// The profile of a stripe, and the points of a scan, on canvases.

const SOFT = "#8b98a8", GRID = "#2a3440", STRIPE = "#ff5a52";
const MARGIN = { left: 48, right: 12, top: 24, bottom: 26 };

/** About `count` round numbers from `low` to `high`. */
function ticks(low, high, count) {
  const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
  const apart = [1, 2, 5, 10].find((by) => by * power >= rough) * power;
  const found = [];
  for (let at = Math.ceil(low / apart) * apart; at <= high; at += apart) found.push(Number(at.toPrecision(10)));
  return found;
}

function mean(points) {
  return [0, 1, 2].map((axis) => points.reduce((sum, point) => sum + point[axis], 0) / points.length);
}

function range(values, least) {
  let low = Infinity, high = -Infinity;
  for (const value of values) { low = Math.min(low, value); high = Math.max(high, value); }
  const room = Math.max(least - (high - low), 0) / 2 + 0.05 * (high - low);
  return [low - room, high + room];
}

/** Draw a profile: across the image in pixels, or with points in mm, x to the right and the camera above. */
export function drawProfile(canvas, profile) {
  const pen = canvas.getContext("2d"), { clientWidth: width, clientHeight: height } = canvas;
  [canvas.width, canvas.height] = [width, height].map((side) => Math.round(side * devicePixelRatio));
  pen.scale(devicePixelRatio, devicePixelRatio);
  pen.clearRect(0, 0, width, height);
  const metric = profile.points?.length > 1;
  const across = metric ? profile.points.map((point) => point[profile.columns ? 0 : 1]) : profile.line;
  const depth = metric ? profile.points.map((point) => point[2]) : profile.position;
  pen.font = "13px system-ui, sans-serif";
  pen.fillStyle = SOFT;
  if (across.length < 2) {
    pen.fillText("no stripe in this photograph", width / 2 - 90, height / 2);
    return;
  }
  const [left, right] = range(across, 1), [top, bottom] = range(depth, metric ? 5 : 20);
  const x = (value) => MARGIN.left + ((value - left) / (right - left)) * (width - MARGIN.left - MARGIN.right);
  const y = (value) => MARGIN.top + ((value - top) / (bottom - top)) * (height - MARGIN.top - MARGIN.bottom);
  pen.strokeStyle = GRID;
  for (const at of ticks(left, right, width / 90)) {
    pen.strokeRect(x(at), MARGIN.top, 0, height - MARGIN.top - MARGIN.bottom);
    pen.fillText(at, x(at) - 8, height - 8);
  }
  for (const at of ticks(top, bottom, 5)) {
    pen.strokeRect(MARGIN.left, y(at), width - MARGIN.left - MARGIN.right, 0);
    pen.fillText(at, 6, y(at) + 4);
  }
  const [alongName, acrossName] = profile.columns ? ["column", "row"] : ["row", "column"];
  pen.fillText(metric ? "mm across; up is nearer to the camera" : `across: ${alongName}, down: ${acrossName} (px)`, MARGIN.left, 15);
  pen.fillStyle = STRIPE;
  for (let i = 0; i < across.length; i++) pen.fillRect(x(across[i]) - 1, y(depth[i]) - 1, 2.5, 2.5);
}

/** Points of an answer: x, y, z as float32. */
export function pointsIn(buffer) {
  const numbers = new Float32Array(buffer), points = [];
  for (let i = 0; i < numbers.length; i += 3) points.push(numbers.subarray(i, i + 3));
  return points;
}

// Colours of marked points, and how far beside a point a click may be, px.
const MARKS = [[255, 90, 70], [80, 160, 255], [80, 220, 120], [220, 110, 255], [255, 190, 40], [60, 220, 220]], NEAR = 8;

/** Points that turn: dragged, or with the arrow keys; plus, minus and the wheel zoom. A click, or Enter for the middle,
    gives `picked` the point that it meets. */
export class CloudView {
  #canvas; #picked; #points = []; #marks = []; #yaw = 0.5; #pitch = 0.9; #zoom = 1; #asked = false;

  constructor(canvas, picked = null) {
    this.#canvas = canvas;
    this.#picked = picked;
    let from = null, moved = 0;
    canvas.addEventListener("pointerdown", (event) => { from = [event.clientX, event.clientY]; moved = 0; canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointerup", (event) => {
      if (from && moved < 4) this.#pick(event.offsetX * canvas.width / canvas.clientWidth, event.offsetY * canvas.height / canvas.clientHeight);
      from = null;
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      const [x, y] = [event.clientX - from[0], event.clientY - from[1]];
      moved += Math.hypot(x, y);
      this.#turn(x / 150, y / 150);
      from = [event.clientX, event.clientY];
    });
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.#scale(event.deltaY < 0 ? 1.1 : 1 / 1.1); }, { passive: false });
    const keys = {
      ArrowLeft: () => this.#turn(-0.1, 0), ArrowRight: () => this.#turn(0.1, 0), ArrowUp: () => this.#turn(0, -0.1),
      ArrowDown: () => this.#turn(0, 0.1), "+": () => this.#scale(1.1), "-": () => this.#scale(1 / 1.1),
      Enter: () => this.#pick(canvas.width / 2, canvas.height / 2),
    };
    canvas.addEventListener("keydown", (event) => { if (keys[event.key]) { event.preventDefault(); keys[event.key](); } });
  }

  get length() { return this.#points.length; }

  /** From corner to corner of the box around the points. */
  get size() { return Math.hypot(...this.#box().map(([, extent]) => extent)); }

  replace(points) { this.#points = points; this.#later(); }

  add(points) { for (const point of points) this.#points.push(point); this.#later(); }

  /** Draw sets of points, each in a colour of its own with its name. */
  mark(sets) { this.#marks = sets; this.#later(); }

  #turn(yaw, pitch) { this.#yaw += yaw; this.#pitch = Math.max(-1.6, Math.min(1.6, this.#pitch + pitch)); this.#later(); }

  #scale(by) { this.#zoom *= by; this.#later(); }

  #later() {
    if (this.#asked) return;
    this.#asked = true;
    requestAnimationFrame(() => { this.#asked = false; this.#draw(); });
  }

  /** The middle and the extent of the points along each axis. */
  #box() {
    return [0, 1, 2].map((axis) => { const [low, high] = range(this.#points.map((point) => point[axis]), 0); return [(low + high) / 2, high - low]; });
  }

  /** A function that says where a point is seen: column, row, and how far away. */
  #seen() {
    const { width, height } = this.#canvas, box = this.#box();
    const size = this.#zoom * 0.95 * Math.min(width, height) / Math.hypot(...box.map((one) => one[1]));
    const [cy, sy, cp, sp] = [Math.cos(this.#yaw), Math.sin(this.#yaw), Math.cos(this.#pitch), Math.sin(this.#pitch)];
    return (point) => {
      const [dx, dy, dz] = [point[0] - box[0][0], point[1] - box[1][0], point[2] - box[2][0]];
      const right = cy * dx - sy * dy, back = sy * dx + cy * dy;
      return [width / 2 + size * right, height / 2 + size * (cp * back + sp * dz), cp * dz - sp * back];
    };
  }

  #pick(column, row) {
    if (!this.#picked || !this.#points.length) return;
    const seen = this.#seen();
    let best = null, least = Infinity;
    for (const point of this.#points) {
      const [x, y, away] = seen(point), beside = Math.hypot(x - column, y - row);
      // The nearest to the eye of those that are about as near to the pointer.
      const cost = beside < NEAR ? Math.floor(beside / 3) * 1e9 + away : Infinity;
      if (cost < least) [least, best] = [cost, point];
    }
    if (best) this.#picked(best);
  }

  #draw() {
    const { width, height } = this.#canvas, pen = this.#canvas.getContext("2d"), points = this.#points;
    const picture = pen.createImageData(width, height), pixels = new Uint32Array(picture.data.buffer);
    const nearest = new Float32Array(width * height).fill(Infinity), names = [];
    if (points.length) {
      const seen = this.#seen(), [middle, span] = this.#box()[2], lowest = middle - span / 2, ahead = 0.01 * this.size;
      const dot = (point, color, before) => {
        const [x, y, away] = seen(point), [column, row] = [Math.round(x), Math.round(y)];
        if (column < 0 || row < 0 || column >= width - 1 || row >= height - 1) return;
        for (const at of [row * width + column, row * width + column + 1, (row + 1) * width + column, (row + 1) * width + column + 1])
          if (away - before < nearest[at]) { nearest[at] = away - before; pixels[at] = color; }
      };
      for (const point of points) dot(point, shade(1 - (point[2] - lowest) / (span || 1)), 0);
      this.#marks.forEach((set, number) => {
        const [r, g, b] = MARKS[number % MARKS.length];
        for (const point of set.points) dot(point, (255 << 24) | (b << 16) | (g << 8) | r, ahead);
        if (set.points.length) names.push([set.name, seen(mean(set.points))]);
      });
    }
    pen.putImageData(picture, 0, 0);
    pen.font = "14px system-ui, sans-serif";
    pen.fillStyle = "#fff";
    for (const [name, [x, y]] of names) pen.fillText(name, x + 4, y - 4);
  }
}

/** From blue, far, over green to yellow, near; as the pixel's bytes. */
function shade(near) {
  const [r, g, b] = [40 + 215 * near ** 1.5, 90 + 150 * Math.sqrt(near), 220 - 170 * near];
  return (255 << 24) | (b << 16) | (g << 8) | r;
}
