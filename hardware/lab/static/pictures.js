// The stream of photographs, read by hand: an <img> shows the last part of such a stream when the next one comes.

const HEAD = /Content-Length: (\d+)\r\n\r\n/, LONGEST_HEAD = 200;

/** Call `show` with the bytes of every JPEG until the stream ends. */
export async function watchPictures(path, signal, show) {
  const reader = (await fetch(path, { signal })).body.getReader();
  let held = new Uint8Array(0);
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    const joined = new Uint8Array(held.length + value.length);
    joined.set(held);
    joined.set(value, held.length);
    held = joined;
    let latest = null;
    for (;;) {
      const head = HEAD.exec(new TextDecoder("latin1").decode(held.subarray(0, LONGEST_HEAD)));
      const begin = head && head.index + head[0].length, end = head && begin + Number(head[1]);
      if (!head || held.length < end) break;
      latest = held.slice(begin, end);
      held = held.subarray(end);
    }
    if (latest) show(latest);
  }
}
