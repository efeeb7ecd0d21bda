// What is drawn of an ego's choice: slots, predicted paths, what really happened, conflicts, alerts.

const STRIP_M = 2.1; // as wide as a slot is drawn
const REACH_M = 45; // and as far ahead of the vehicle behind it
const STILL_M = 0.8; // shorter paths are not drawn
const AHEAD_FRAMES = 30; // what happened is shown for as long as was predicted: 3 s

function pathLength(points) {
  let length = 0;
  for (let i = 1; i < points.length; i++) {
    length += Math.hypot(points[i][0] - points[i - 1][0], points[i][1] - points[i - 1][1]);
  }
  return length;
}

// The middle of a slot, from the front bumper of the vehicle behind it on; null: it is on no line.
function slotStrip(app, rear, length) {
  const number = rear.chunk.line[rear.row] - 1;
  if (number < 0) return null;
  if (!app.lines[number]) app.lines[number] = decodeLine(app.head.lines[number]);
  const from = rear.chunk.s[rear.row] / 10 + app.head.vehicles[rear.vehicle].length_m / 2;
  return alongLine(app.lines[number], from, from + Math.min(Math.max(length, 0.5), REACH_M));
}

function strokeStrip(ctx, points, fill, edge) {
  const path = new Path2D();
  addPoints(path, points);
  ctx.lineCap = 'butt';
  ctx.lineJoin = 'round';
  ctx.lineWidth = STRIP_M;
  ctx.strokeStyle = edge;
  ctx.stroke(path);
  ctx.lineWidth = STRIP_M - 0.24;
  ctx.strokeStyle = fill;
  ctx.stroke(path);
}

function drawSlots(ctx, app, view) {
  const drawn = [...view.slots].sort((a, b) => (a.chance ?? -1) - (b.chance ?? -1));
  for (const slot of drawn) {
    const rear = view.logged.get(slot.vehicle);
    const strip = rear && slotStrip(app, rear, slot.length);
    if (!strip) continue;
    if (slot.chance === null) strokeStrip(ctx, strip, 'rgba(255,255,255,0.1)', 'rgba(255,255,255,0.12)');
    else strokeStrip(ctx, strip, chanceColour(slot.chance, 0.86), 'rgba(255,255,255,0.55)');
  }
}

// Predicted paths, the likelier the stronger, with a dot each 0.5 s; then what really happened.
function drawForecasts(ctx, app, view) {
  const told = [...view.states.values()].filter((state) => state.chunk.modeCount[state.row] > 0);
  told.sort((a, b) => view.involved.has(a.vehicle) - view.involved.has(b.vehicle));
  for (const state of told) {
    const strength = view.involved.has(state.vehicle) ? 1 : 0.3;
    const modes = modesOf(state).filter(({ points }) => pathLength(points) > STILL_M);
    for (const { chance, points } of modes.reverse()) {
      const alpha = strength * (chance / modes[modes.length - 1].chance);
      drawPredicted(ctx, smooth(points), points.slice(1), alpha, app.look);
    }
  }
  for (const state of told) {
    const strength = view.involved.has(state.vehicle) ? 1 : 0.35;
    drawHappened(ctx, happened(app, state.vehicle, view.frame), strength, app.look);
  }
}

// Way points are 0.5 s apart: a Catmull-Rom curve through them.
function smooth(points) {
  const out = [points[0]];
  for (let i = 0; i + 1 < points.length; i++) {
    const [a, b] = [points[Math.max(i - 1, 0)], points[i]];
    const [c, d] = [points[i + 1], points[Math.min(i + 2, points.length - 1)]];
    for (let k = 1; k <= 5; k++) {
      const t = k / 5;
      out.push([0, 1].map((n) => 0.5 * (2 * b[n] + (c[n] - a[n]) * t
        + (2 * a[n] - 5 * b[n] + 4 * c[n] - d[n]) * t * t
        + (3 * b[n] - a[n] - 3 * c[n] + d[n]) * t * t * t)));
    }
  }
  return out;
}

function drawPredicted(ctx, curve, dots, alpha, look) {
  const path = new Path2D();
  addPoints(path, curve);
  const [from, to] = [curve[0], curve[curve.length - 1]];
  const fading = (strength) => {
    const gradient = ctx.createLinearGradient(from[0], from[1], to[0], to[1]);
    const hex = (part) => Math.round(255 * part * strength).toString(16).padStart(2, '0');
    gradient.addColorStop(0, look.predicted + hex(1));
    gradient.addColorStop(1, look.predicted + hex(0.35));
    return gradient;
  };
  ctx.lineCap = 'butt';
  ctx.lineWidth = 0.66;
  ctx.strokeStyle = look.ink;
  ctx.globalAlpha = 0.3 * alpha;
  ctx.stroke(path);
  ctx.globalAlpha = 1;
  ctx.lineWidth = 0.5;
  ctx.strokeStyle = fading(alpha);
  ctx.stroke(path);
  ctx.fillStyle = look.predicted;
  dots.forEach(([x, y], i) => {
    ctx.globalAlpha = Math.min(1, alpha * (1 - 0.1 * i) + 0.2 * alpha);
    ctx.beginPath();
    ctx.arc(x, y, 0.42, 0, 2 * Math.PI);
    ctx.fill();
  });
  ctx.globalAlpha = 1;
}

// Where a vehicle really was in the next 3 s, as far as its frames are there.
function happened(app, vehicle, frame) {
  const points = [];
  for (let ahead = 0; ahead <= AHEAD_FRAMES; ahead++) {
    const state = stateAt(app.store, app.head, frame + ahead, vehicle);
    if (!state) break;
    points.push([state.x, state.y]);
  }
  return points;
}

function drawHappened(ctx, points, alpha, look) {
  if (points.length < 2 || pathLength(points) < STILL_M) return;
  const path = new Path2D();
  addPoints(path, points);
  for (const [width, colour, share] of [[0.34, look.ink, 0.45], [0.17, look.actual, 1]]) {
    ctx.lineWidth = width;
    ctx.strokeStyle = colour;
    ctx.globalAlpha = share * alpha;
    ctx.stroke(path);
  }
  const end = points[points.length - 1];
  ctx.globalAlpha = Math.max(alpha, 0.5);
  ctx.fillStyle = look.asphalt;
  ctx.strokeStyle = look.actual;
  ctx.lineWidth = 0.17;
  ctx.beginPath();
  ctx.arc(end[0], end[1], 0.36, 0, 2 * Math.PI);
  ctx.fill();
  ctx.stroke();
  ctx.globalAlpha = 1;
}

function drawConflicts(ctx, view, look) {
  for (const slot of view.slots) {
    if (slot.own || !slot.focus || !slot.conflict) continue;
    const [x, y] = slot.conflict;
    ctx.beginPath();
    ctx.moveTo(x + 0.7, y);
    ctx.lineTo(x, y + 0.7);
    ctx.lineTo(x - 0.7, y);
    ctx.lineTo(x, y - 0.7);
    ctx.closePath();
    ctx.fillStyle = look.ink;
    ctx.strokeStyle = '#ffffff';
    ctx.lineWidth = 0.2;
    ctx.fill();
    ctx.stroke();
  }
}

// Where the two of an event met: a cross, as large on the screen at all scales.
function drawMeeting(ctx, camera, [x, y]) {
  const arm = 6 / camera.scale;
  for (const [width, colour] of [[6, '#ffffff'], [3, ALARM]]) {
    ctx.beginPath();
    ctx.moveTo(x - arm, y - arm); ctx.lineTo(x + arm, y + arm);
    ctx.moveTo(x + arm, y - arm); ctx.lineTo(x - arm, y + arm);
    ctx.lineCap = 'round';
    ctx.lineWidth = width / camera.scale;
    ctx.strokeStyle = colour;
    ctx.stroke();
  }
  ctx.lineCap = 'butt';
}

// Rings around those that an alert names: they flash twice a second of the wall clock while the run is
// played, however fast, and are steady for whoever wants no motion.
function drawAlarms(ctx, app, view) {
  for (const alert of view.alerts) {
    for (const vehicle of [alert.ego, alert.other]) {
      const state = view.states.get(vehicle);
      if (!state) continue;
      const on = app.still || !app.playing || Math.floor(performance.now() / 250) % 2 === 0;
      placed(ctx, app.camera, state, () => {
        ctx.strokeStyle = ALARM;
        ctx.globalAlpha = on ? 1 : 0.35;
        ctx.lineWidth = Math.max(0.45, 3 / app.camera.scale);
        ctx.stroke(app.shapes(vehicle).rings[3]);
        ctx.globalAlpha = 1;
      });
    }
  }
}
