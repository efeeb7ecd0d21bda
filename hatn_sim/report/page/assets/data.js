// The data of the page: base64 of deflated bytes -> whole numbers -> what is there at a frame.
// The order of the numbers is told in motion.py.

const PER_M = 50; // positions are in units of 2 cm
const YAW_UNIT = (2 * Math.PI) / 4096;
const WAY_POINTS = 6; // at 0.5 s ... 3 s
const KEPT_CHUNKS = 12;
const FLAG = { fallback: 1, adapted: 2, conflict: 4, predicted: 8 };

function unpacked(base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return inflated(bytes);
}

function unpackedJson(base64) {
  return JSON.parse(new TextDecoder().decode(unpacked(base64)));
}

// Zigzag varints -> a reader of columns.
function columnsOf(bytes) {
  let at = 0;
  const next = () => {
    let value = 0, scale = 1, octet;
    do {
      octet = bytes[at++];
      value += (octet & 127) * scale;
      scale *= 128;
    } while (octet & 128);
    return value % 2 ? -(value + 1) / 2 : value / 2;
  };
  const column = (count) => {
    const out = new Int32Array(count);
    for (let i = 0; i < count; i++) out[i] = next();
    return out;
  };
  return { next, column };
}

// Sums along stretches: the inverse of first differences.
function summed(values, starts) {
  for (let i = 1; i < values.length; i++) if (!starts[i]) values[i] += values[i - 1];
  return values;
}

// The inverse of second differences: the first two of each stretch start sums of their own.
function summedTwice(values, starts) {
  for (let i = 2; i < values.length; i++) {
    if (!starts[i] && !starts[i - 1]) values[i] += values[i - 1];
  }
  return summed(values, starts);
}

function everyNth(count, n) {
  const starts = new Uint8Array(count);
  for (let i = 0; i < count; i += n) starts[i] = 1;
  return starts;
}

function decodeChunk(bytes) {
  const read = columnsOf(bytes);
  const frames = read.next(), stretches = read.next(), rows = read.next();
  const vehicle = read.column(stretches), first = read.column(stretches);
  const count = read.column(stretches);
  const starts = new Uint8Array(rows);
  const rowAt = Array.from({ length: frames }, () => new Map()); // vehicle -> row, by frame
  for (let i = 0, row = 0; i < stretches; i++) {
    starts[row] = 1;
    for (let k = 0; k < count[i]; k++, row++) rowAt[first[i] + k].set(vehicle[i], row);
  }
  const chunk = { frames, rowAt };
  chunk.x = summedTwice(read.column(rows), starts);
  chunk.y = summedTwice(read.column(rows), starts);
  chunk.yaw = summedTwice(read.column(rows), starts);
  chunk.speed = summed(read.column(rows), starts);
  chunk.blinker = summed(read.column(rows), starts);
  chunk.closed = decodeSignals(read, frames);
  chunk.flags = summed(read.column(rows), starts);
  chunk.line = summed(read.column(rows), starts);
  const newLine = starts.slice();
  for (let i = 1; i < rows; i++) if (chunk.line[i] !== chunk.line[i - 1]) newLine[i] = 1;
  chunk.s = summedTwice(read.column(rows), newLine);
  chunk.modeCount = read.column(rows);
  chunk.slotCount = read.column(rows);
  chunk.modeFrom = offsets(chunk.modeCount);
  chunk.slotFrom = offsets(chunk.slotCount);
  const modes = chunk.modeFrom[rows], slots = chunk.slotFrom[rows];
  if (modes + slots === 0) return chunk;
  const paths = everyNth(modes * WAY_POINTS, WAY_POINTS);
  chunk.modeChance = read.column(modes);
  chunk.forward = summedTwice(read.column(modes * WAY_POINTS), paths);
  chunk.left = summedTwice(read.column(modes * WAY_POINTS), paths);
  const once = everyNth(slots, Infinity);
  chunk.slotVehicle = summed(read.column(slots), once);
  chunk.slotChance = read.column(slots);
  chunk.slotFocus = read.column(slots);
  chunk.slotType = read.column(slots);
  chunk.slotLength = read.column(slots);
  chunk.conflictX = summed(read.column(slots), once);
  chunk.conflictY = summed(read.column(slots), once);
  chunk.egoTo = read.column(slots);
  chunk.rearTo = read.column(slots);
  return chunk;
}

function offsets(counts) {
  const from = new Int32Array(counts.length + 1);
  for (let i = 0; i < counts.length; i++) from[i + 1] = from[i] + counts[i];
  return from;
}

function decodeSignals(read, frames) {
  const links = read.next(), changes = read.next();
  const now = read.column(links), frame = summed(read.column(changes), everyNth(changes, Infinity));
  const link = read.column(changes);
  const closed = [];
  for (let f = 0, k = 0; f < frames; f++) {
    for (; k < changes && frame[k] === f; k++) now[link[k]] ^= 1;
    closed.push(now.slice());
  }
  return closed;
}

// The run's chunks, decoded when needed; the least used are let go.
function chunkStore(head) {
  const kept = new Map(); // number -> chunk, the last used last
  const last = Math.ceil(head.frames / head.chunk_frames) - 1;
  // While the page arrives, the last element may not be whole yet.
  const arrived = (element) => element && (document.readyState !== 'loading' || element.nextElementSibling);
  return {
    // Undefined: it has not arrived, or there is none of this number.
    now(number) {
      let chunk = kept.get(number);
      if (!chunk) {
        const element = number >= 0 && number <= last && document.getElementById(`chunk-${number}`);
        if (!arrived(element)) return undefined;
        chunk = decodeChunk(unpacked(element.textContent));
      }
      kept.delete(number);
      kept.set(number, chunk);
      while (kept.size > KEPT_CHUNKS) kept.delete(kept.keys().next().value);
      return chunk;
    },
    ready: (number) => number < 0 || number > last || kept.has(number),
  };
}

// A vehicle at a frame: metres from the origin, radians, m/s; null where it is not in view.
function stateAt(store, head, frame, vehicle) {
  const chunk = store.now(Math.floor(frame / head.chunk_frames));
  const row = chunk?.rowAt[frame % head.chunk_frames]?.get(vehicle); // no frame after the last
  return row === undefined ? null : stateOf(chunk, row, vehicle);
}

function stateOf(chunk, row, vehicle) {
  return {
    vehicle, chunk, row,
    x: chunk.x[row] / PER_M, y: chunk.y[row] / PER_M, yaw: chunk.yaw[row] * YAW_UNIT,
    speed: chunk.speed[row] / 10, blinker: chunk.blinker[row],
  };
}

// What was predicted of it: paths from now on, [{chance, points: [[x, y], ...]}], likeliest first.
function modesOf(state) {
  const { chunk, row } = state;
  const cos = Math.cos(state.yaw), sin = Math.sin(state.yaw);
  const out = [];
  for (let mode = chunk.modeFrom[row]; mode < chunk.modeFrom[row + 1]; mode++) {
    const points = [[state.x, state.y]];
    for (let k = mode * WAY_POINTS; k < (mode + 1) * WAY_POINTS; k++) {
      const forward = chunk.forward[k] / 10, left = chunk.left[k] / 10;
      points.push([state.x + cos * forward - sin * left, state.y + sin * forward + cos * left]);
    }
    out.push({ chance: chunk.modeChance[mode] / 100, points });
  }
  return out.sort((a, b) => b.chance - a.chance);
}

// Its slots, its own first; chance null where none is given.
function slotsOf(state) {
  const { chunk, row } = state;
  const conflict = (chunk.flags[row] & FLAG.conflict) !== 0;
  const out = [];
  for (let k = chunk.slotFrom[row]; k < chunk.slotFrom[row + 1]; k++) {
    out.push({
      vehicle: chunk.slotVehicle[k],
      own: k === chunk.slotFrom[row],
      focus: chunk.slotFocus[k] === 1,
      chance: conflict && chunk.slotChance[k] > 0 ? (chunk.slotChance[k] - 1) / 100 : null,
      length: Math.max(0, chunk.slotLength[k] / 10),
      conflict: conflict ? [chunk.conflictX[k] / 10, chunk.conflictY[k] / 10] : null,
      merge: chunk.slotType[k] === 1,
      egoTo: chunk.egoTo[k] / 10,
      rearTo: chunk.rearTo[k] / 10,
    });
  }
  return out;
}

// Reference lines: vertices each metre from `s` on, in metres from the origin.
function decodeLine(line) {
  const starts = everyNth(line.x.length, Infinity);
  return {
    s: line.s,
    x: summedTwice(Int32Array.from(line.x), starts),
    y: summedTwice(Int32Array.from(line.y), starts),
  };
}

// The part of a line from one arc length to another.
function alongLine(line, fromS, toS) {
  const last = line.x.length - 1;
  const at = (s) => {
    const where = Math.min(Math.max(s - line.s, 0), last);
    const i = Math.min(Math.floor(where), Math.max(last - 1, 0)), part = where - i;
    const j = Math.min(i + 1, last);
    return [
      (line.x[i] + part * (line.x[j] - line.x[i])) / PER_M,
      (line.y[i] + part * (line.y[j] - line.y[i])) / PER_M,
    ];
  };
  const points = [at(fromS)];
  for (let s = Math.floor(fromS) + 1; s < toS; s++) points.push(at(s));
  points.push(at(toS));
  return points;
}
