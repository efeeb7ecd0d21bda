// Raw deflate (RFC 1951) -> bytes, at once: the first picture is there before the page is said to be
// loaded, and a jump shows the moment itself. What browsers have for it answers later only.

const LENGTHS = bases(3, [0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5]);
LENGTHS.base.push(258); // the longest has a code of its own
LENGTHS.extra.push(0);
const DISTANCES = bases(1, [0, 0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8, 8, 9, 9, 10, 10,
  11, 11, 12, 12, 13, 13]);
const LENGTH_ORDER = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];
const FAST_BITS = 10; // codes up to so many bits are found by one look

function bases(first, extra) {
  const base = [];
  for (let i = 0, at = first; i < extra.length; at += 1 << extra[i++]) base.push(at);
  return { base, extra };
}

// Lengths of codes -> a table by the next bits (symbol * 16 + length; 0: a longer code), and what it
// takes to go on bit by bit.
function codeOf(lengths) {
  const counts = new Uint16Array(16), next = new Uint16Array(16), from = new Uint16Array(17);
  for (const length of lengths) counts[length]++;
  counts[0] = 0;
  for (let bits = 1; bits < 16; bits++) {
    next[bits] = (next[bits - 1] + counts[bits - 1]) << 1;
    from[bits + 1] = from[bits] + counts[bits];
  }
  const symbols = new Uint16Array(lengths.length), fast = new Uint16Array(1 << FAST_BITS);
  const filled = from.slice();
  for (let symbol = 0; symbol < lengths.length; symbol++) {
    const length = lengths[symbol];
    if (!length) continue;
    symbols[filled[length]++] = symbol;
    const code = next[length]++;
    if (length > FAST_BITS) continue;
    let turned = 0; // codes come with their first bit first
    for (let bit = 0; bit < length; bit++) turned |= ((code >> bit) & 1) << (length - 1 - bit);
    for (let at = turned; at < fast.length; at += 1 << length) fast[at] = symbol * 16 + length;
  }
  return { counts, symbols, fast };
}

const fixedLengths = Uint8Array.from({ length: 288 }, (_, i) => (i < 144 ? 8 : i < 256 ? 9 : i < 280 ? 7 : 8));
const FIXED = [codeOf(fixedLengths), codeOf(new Uint8Array(30).fill(5))];

function inflated(bytes) {
  let out = new Uint8Array(Math.max(4 * bytes.length, 1024)), size = 0;
  let at = 0, held = 0, count = 0; // bits that were read but not used
  const need = (bits) => {
    while (count < bits) { held |= (bytes[at++] || 0) << count; count += 8; }
  };
  const take = (bits) => {
    need(bits);
    const value = held & ((1 << bits) - 1);
    held >>>= bits;
    count -= bits;
    return value;
  };
  const symbol = ({ counts, symbols, fast }) => {
    need(15);
    const found = fast[held & (fast.length - 1)];
    if (found) {
      held >>>= found & 15;
      count -= found & 15;
      return found >> 4;
    }
    for (let bits = 1, code = 0, first = 0, index = 0; bits < 16; bits++) {
      code |= take(1);
      if (code - first < counts[bits]) return symbols[index + code - first];
      index += counts[bits];
      first = (first + counts[bits]) << 1;
      code <<= 1;
    }
    throw new Error('the data of this page are damaged');
  };
  const room = (more) => {
    if (at > bytes.length + 4) throw new Error('the data of this page are cut off');
    if (size + more <= out.length) return;
    const larger = new Uint8Array(2 * (size + more));
    larger.set(out.subarray(0, size));
    out = larger;
  };
  for (let last = false; !last;) {
    last = take(1) === 1;
    const kind = take(2);
    if (kind === 0) {
      at -= count >> 3; // whole bytes that were read ahead
      held = count = 0;
      const length = bytes[at] | (bytes[at + 1] << 8);
      room(length);
      out.set(bytes.subarray(at + 4, at + 4 + length), size);
      at += 4 + length;
      size += length;
      continue;
    }
    const [literals, distances] = kind === 1 ? FIXED : written(take, symbol);
    for (let code = symbol(literals); code !== 256; code = symbol(literals)) {
      if (code < 256) {
        room(1);
        out[size++] = code;
        continue;
      }
      const length = LENGTHS.base[code - 257] + take(LENGTHS.extra[code - 257]);
      const way = symbol(distances);
      const back = DISTANCES.base[way] + take(DISTANCES.extra[way]);
      room(length);
      for (const end = size + length; size < end; size++) out[size] = out[size - back];
    }
  }
  return out.subarray(0, size);
}

// The codes that a block brings with it.
function written(take, symbol) {
  const literals = take(5) + 257, distances = take(5) + 1, told = take(4) + 4;
  const ofLengths = new Uint8Array(19);
  for (let i = 0; i < told; i++) ofLengths[LENGTH_ORDER[i]] = take(3);
  const code = codeOf(ofLengths);
  const lengths = new Uint8Array(literals + distances);
  for (let i = 0; i < lengths.length;) {
    const next = symbol(code);
    if (next < 16) lengths[i++] = next;
    else {
      const value = next === 16 ? lengths[i - 1] : 0;
      const times = next === 16 ? 3 + take(2) : next === 17 ? 3 + take(3) : 11 + take(7);
      lengths.fill(value, i, i + times);
      i += times;
    }
  }
  return [codeOf(lengths.subarray(0, literals)), codeOf(lengths.subarray(literals))];
}
