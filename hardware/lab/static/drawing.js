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
  pen.fillText(metric ? "mm across; up is nearer to the camera" : `${alongName}; upwards the ${acrossName}, px`, MARGIN.left, 15);
  pen.fillStyle = STRIPE;
  for (let i = 0; i < across.length; i++) pen.fillRect(x(across[i]) - 1, y(depth[i]) - 1, 2.5, 2.5);
}

/** Points that turn: dragged, or with the arrow keys; plus, minus and the wheel zoom. */
export class CloudView {
  #canvas; #points = []; #yaw = 0.5; #pitch = 0.9; #zoom = 1; #asked = false;

  constructor(canvas) {
    this.#canvas = canvas;
    let from = null;
    canvas.addEventListener("pointerdown", (event) => { from = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointerup", () => { from = null; });
    canvas.addEventListener("pointermove", (event) => {
      if (from) this.#turn((event.clientX - from[0]) / 150, (event.clientY - from[1]) / 150);
      if (from) from = [event.clientX, event.clientY];
    });
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.#scale(event.deltaY < 0 ? 1.1 : 1 / 1.1); }, { passive: false });
    const keys = {
      ArrowLeft: () => this.#turn(-0.1, 0), ArrowRight: () => this.#turn(0.1, 0), ArrowUp: () => this.#turn(0, -0.1),
      ArrowDown: () => this.#turn(0, 0.1), "+": () => this.#scale(1.1), "-": () => this.#scale(1 / 1.1),
    };
    canvas.addEventListener("keydown", (event) => { if (keys[event.key]) { event.preventDefault(); keys[event.key](); } });
  }

  get length() { return this.#points.length; }

  replace(points) { this.#points = points; this.#later(); }

  add(points) { for (const point of points) this.#points.push(point); this.#later(); }

  #turn(yaw, pitch) { this.#yaw += yaw; this.#pitch = Math.max(-1.6, Math.min(1.6, this.#pitch + pitch)); this.#later(); }

  #scale(by) { this.#zoom *= by; this.#later(); }

  #later() {
    if (this.#asked) return;
    this.#asked = true;
    requestAnimationFrame(() => { this.#asked = false; this.#draw(); });
  }

  #draw() {
    const { width, height } = this.#canvas, pen = this.#canvas.getContext("2d"), points = this.#points;
    const picture = pen.createImageData(width, height), pixels = new Uint32Array(picture.data.buffer);
    const nearest = new Float32Array(width * height).fill(Infinity);
    if (points.length) {
      const middle = [0, 1, 2].map((axis) => { const [low, high] = range(points.map((point) => point[axis]), 0); return [(low + high) / 2, high - low]; });
      const size = this.#zoom * 0.95 * Math.min(width, height) / Math.hypot(...middle.map((one) => one[1]));
      const [cy, sy, cp, sp] = [Math.cos(this.#yaw), Math.sin(this.#yaw), Math.cos(this.#pitch), Math.sin(this.#pitch)];
      const [lowest, span] = [middle[2][0] - middle[2][1] / 2, middle[2][1] || 1];
      for (const point of points) {
        const [dx, dy, dz] = [point[0] - middle[0][0], point[1] - middle[1][0], point[2] - middle[2][0]];
        const right = cy * dx - sy * dy, back = sy * dx + cy * dy;
        const down = cp * back + sp * dz, away = cp * dz - sp * back;
        const column = Math.round(width / 2 + size * right), row = Math.round(height / 2 + size * down);
        if (column < 0 || row < 0 || column >= width - 1 || row >= height - 1) continue;
        const color = shade(1 - (point[2] - lowest) / span);
        for (const at of [row * width + column, row * width + column + 1, (row + 1) * width + column, (row + 1) * width + column + 1])
          if (away < nearest[at]) { nearest[at] = away; pixels[at] = color; }
      }
    }
    pen.putImageData(picture, 0, 0);
  }
}

/** From blue, far, over green to yellow, near; as the pixel's bytes. */
function shade(near) {
  const [r, g, b] = [40 + 215 * near ** 1.5, 90 + 150 * Math.sqrt(near), 220 - 170 * near];
  return (255 << 24) | (b << 16) | (g << 8) | r;
}
