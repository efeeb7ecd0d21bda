// Words beside vehicles, in pixels, each where it covers least: neither slots, conflicts and vehicles
// nor other words, nor what lies over the map.

const LABEL_PX = 20, DOT_PX = 7;
const SIDES = [[1, -1], [1, 1], [-1, -1], [-1, 1], [1, 0], [-1, 0], [0, -1], [0, 1]];
const AWAY = [1, 1.7, 2.6, 3.8, 5.2];
const HELD = 4; // what a place gains that a label had in the picture before

// Points [x, y, weight] of what is better not covered.
function obstaclesOf(app, view) {
  const { camera } = app, dots = [];
  const along = (points, weight) => {
    const shown = points.map(([x, y]) => camera.toScreen(x, y));
    shown.forEach(([x, y], i) => {
      const [beforeX, beforeY] = shown[Math.max(i - 1, 0)];
      const count = Math.min(Math.ceil(Math.hypot(x - beforeX, y - beforeY) / DOT_PX), 200) || 1;
      for (let k = 1; k <= count; k++) {
        dots.push([beforeX + (k / count) * (x - beforeX), beforeY + (k / count) * (y - beforeY), weight]);
      }
    });
  };
  for (const state of view.states.values()) {
    if (!camera.sees(state.x, state.y, 20)) continue;
    const [a, b, c, d] = cornersOf(app, state);
    along([a, b, d, c, a, d], 3);
  }
  if (view.event?.met) dots.push([...camera.toScreen(...view.event.met), 30]);
  for (const slot of view.slots) {
    const rear = slot.chance !== null && view.logged.get(slot.vehicle);
    const strip = rear && slotStrip(app, rear, slot.length);
    if (strip) along(strip, 2);
    if (slot.conflict && !slot.own && slot.focus) dots.push([...camera.toScreen(...slot.conflict), 30]);
  }
  for (const vehicle of view.involved.keys()) {
    const state = view.states.get(vehicle);
    if (state) for (const { points } of modesOf(state)) along(points, 0.5);
  }
  return dots;
}

function overlap(a, b) {
  return a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
}

// The best of a few places around a point: [number of the place, box].
function placeFor([x, y], width, away, { camera, covers, taken, dots, held }) {
  let best = null, least = Infinity;
  AWAY.forEach((far, i) => SIDES.forEach(([right, down], k) => {
    const number = i * SIDES.length + k;
    const middleX = x + right * (0.8 * far * away + width / 2);
    const middleY = y + down * (far * away + LABEL_PX / 2);
    const box = [middleX - width / 2, middleY - LABEL_PX / 2, middleX + width / 2, middleY + LABEL_PX / 2];
    let cost = 0.06 * far * away - (number === held ? HELD : 0);
    if (box[0] < 4 || box[1] < 4 || box[2] > camera.width - 4 || box[3] > camera.height - 4) cost += 4e3;
    if (covers.some((cover) => overlap(cover, box))) cost += 4e3;
    if (taken.some((other) => overlap(other, box))) cost += 4e3;
    for (const [dotX, dotY, weight] of dots) {
      if (dotX > box[0] - 3 && dotX < box[2] + 3 && dotY > box[1] - 3 && dotY < box[3] + 3) cost += weight;
    }
    if (cost < least) { least = cost; best = [number, box]; }
  }));
  return best;
}

// What is written: {key, state, words, back, fore}; the ego first, then those it is told of.
function labelsOf(app, view) {
  const found = [];
  const isNamed = (vehicle) => view.named.includes(vehicle);
  if (view.ego) {
    const own = view.slots.find((slot) => slot.own && slot.chance !== null);
    found.push({ state: view.ego, words: own ? `ego: yield ${percent(own.chance)}` : 'ego', back: '#ffffff', fore: '#22262b' });
  }
  const slots = view.slots.filter((slot) => !slot.own && slot.chance !== null && view.states.has(slot.vehicle));
  slots.sort((a, b) => isNamed(b.vehicle) - isNamed(a.vehicle));
  for (const { vehicle, chance } of slots) {
    const words = `${isNamed(vehicle) ? `${app.head.vehicles[vehicle].look}: ` : ''}pass before ${percent(chance)}`;
    found.push({ state: view.states.get(vehicle), words, back: chanceColour(chance), fore: chance > 0.55 ? '#10151a' : '#ffffff' });
  }
  const { event } = view;
  if (event && event.other >= 0) {
    const words = `${app.head.vehicles[event.other].look}: ${event.isFor ? 'braked for' : TIERS[event.kind]}`;
    found.push({ state: view.states.get(event.other), words, back: '#ffffff', fore: '#22262b', key: 'event' });
  }
  if (event?.met) {
    const [x, y] = event.met;
    found.push({ state: { x, y, vehicle: -1 }, words: 'where they met', back: '#ffffff', fore: '#22262b' });
  }
  for (const vehicle of view.named) {
    if (vehicle === event?.other) continue;
    if (slots.some((slot) => slot.vehicle === vehicle)) continue;
    found.push({ state: view.states.get(vehicle), words: app.head.vehicles[vehicle].look, back: '#ffffff', fore: '#22262b' });
  }
  for (const alert of view.alerts) {
    const state = view.states.get(alert.ego);
    if (state) found.push({ state, words: '! alert', back: ALARM, fore: '#ffffff' });
  }
  return found.map((label) => ({ key: `${label.state.vehicle} ${label.back === ALARM}`, ...label }));
}

function drawLabels(ctx, app, view) {
  ctx.font = '600 12px system-ui, sans-serif';
  ctx.textBaseline = 'middle';
  const held = app.playing ? app.labelPlaces : new Map();
  app.labelPlaces = new Map();
  app.labels = [];
  const around = { camera: app.camera, covers: app.covers, taken: [], dots: obstaclesOf(app, view) };
  const away = Math.max(14, 2 * app.camera.scale);
  const write = ({ key, state, words, back, fore }) => {
    const at = app.camera.toScreen(state.x, state.y);
    if (at[0] < 0 || at[1] < 0 || at[0] > app.camera.width || at[1] > app.camera.height) return;
    const width = ctx.measureText(words).width + 12;
    const [number, box] = placeFor(at, width, away, { ...around, held: held.get(key) });
    around.taken.push(box);
    app.labelPlaces.set(key, number);
    app.labels.push({ words, box, vehicle: state.vehicle });
    ctx.strokeStyle = app.look.leader;
    ctx.lineWidth = 1;
    const end = [Math.min(Math.max(at[0], box[0]), box[2]), Math.min(Math.max(at[1], box[1]), box[3])];
    const bare = app.camera.scale / Math.max(Math.hypot(end[0] - at[0], end[1] - at[1]), 1); // 1 m
    ctx.beginPath();
    ctx.moveTo(at[0] + bare * (end[0] - at[0]), at[1] + bare * (end[1] - at[1]));
    ctx.lineTo(...end);
    ctx.stroke();
    ctx.fillStyle = back;
    ctx.beginPath();
    ctx.roundRect(box[0], box[1], width, LABEL_PX, 5);
    ctx.fill();
    ctx.stroke();
    ctx.fillStyle = fore;
    ctx.fillText(words, box[0] + 6, box[1] + LABEL_PX / 2 + 0.5);
  };
  labelsOf(app, view).forEach(write);
  const pointed = view.states.get(app.pointed);
  if (!pointed) return;
  const words = `${shortened(app.head.vehicles[app.pointed].id, 40)}  ${pointed.speed.toFixed(1)} m/s`;
  write({ key: 'pointed', state: pointed, words, back: 'rgba(20,23,26,0.88)', fore: '#ffffff' });
}

function percent(chance) {
  return `${Math.round(100 * chance)} %`;
}

function shortened(text, most) {
  return text.length > most ? `${text.slice(0, most - 1)}\u2026` : text;
}
