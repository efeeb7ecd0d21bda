// Where the camera looks when a moment is opened, and while it plays: at the ego, those that its advice and alerts name
// and where they meet, in the part of the map that nothing lies over.

const EDGE_PX = 26; // kept free around what is looked at
const CLOSE_SCALE = 8, FULL_SCALE = 5, FAR_SCALE = 1.3; // CSS pixels per metre
const CALM_PX = 70, CALM_S = 0.25; // from here to an edge the camera moves, in about so long
const LEAST_CALM_SCALE = 3.5; // and goes no farther away than this to hold all of it
const BAR_PX = [170, 40]; // room that the scale bar takes in its corner

// Those that the ego is told of now, by its alerts and its advice.
function namedOf(app, view) {
  const warned = view.alerts.filter(({ ego, other }) => ego === app.ego || other === app.ego)
    .map(({ ego, other }) => (ego === app.ego ? other : ego));
  const advised = view.advice ? [view.advice.slot] : [];
  return [...new Set([...warned, ...advised])].filter((vehicle) => view.states.has(vehicle));
}

// What lies over the map, as [left, top, right, bottom] in its pixels.
function coversOf(canvas) {
  const map = canvas.getBoundingClientRect();
  const covers = [[map.width - BAR_PX[0], map.height - BAR_PX[1], map.width, map.height]];
  for (const part of document.querySelectorAll('#said, #clock, .zoom, #legend')) {
    if (part.id === 'said' && !part.textContent) continue;
    const box = part.getBoundingClientRect();
    const cover = [Math.max(box.left - map.left, 0), Math.max(box.top - map.top, 0),
      Math.min(box.right - map.left, map.width), Math.min(box.bottom - map.top, map.height)];
    if (cover[0] < cover[2] && cover[1] < cover[3]) covers.push(cover);
  }
  return covers;
}

// The rectangles of a map that lie under nothing and touch a cover or the border on every side.
function freeRectangles(width, height, covers) {
  const found = [];
  for (const left of [0, ...covers.map((cover) => cover[2])]) {
    for (const right of [width, ...covers.map((cover) => cover[0])]) {
      if (right - left < 2) continue;
      for (const top of [0, ...covers.map((cover) => cover[3])]) {
        for (const bottom of [height, ...covers.map((cover) => cover[1])]) {
          const free = bottom - top >= 2 && covers.every((cover) =>
            cover[2] <= left || right <= cover[0] || cover[3] <= top || bottom <= cover[1]);
          if (free) found.push([left, top, right, bottom]);
        }
      }
    }
  }
  return found;
}

// The corners of a vehicle, with the rings around it.
function cornersOf(app, state) {
  const { length_m: length, width_m: width } = app.head.vehicles[state.vehicle];
  const [along, across] = [length / 2 + 1.1, width / 2 + 1.1];
  const [cos, sin] = [Math.cos(state.yaw), Math.sin(state.yaw)];
  return [[along, across], [along, -across], [-along, across], [-along, -across]]
    .map(([x, y]) => [state.x + cos * x - sin * y, state.y + sin * x + cos * y]);
}

// The scale at which points fit between the edges of a rectangle.
function scaleFor(points, [left, top, right, bottom]) {
  const [xs, ys] = [0, 1].map((k) => points.map((point) => point[k]));
  const edge = Math.min(EDGE_PX, 0.1 * (right - left), 0.1 * (bottom - top));
  return Math.min((right - left - 2 * edge) / (Math.max(...xs) - Math.min(...xs)),
    (bottom - top - 2 * edge) / (Math.max(...ys) - Math.min(...ys)), CLOSE_SCALE);
}

function lookInto(camera, points, [left, top, right, bottom], scale) {
  const [x, y] = [0, 1].map((k) => {
    const along = points.map((point) => point[k]);
    return (Math.min(...along) + Math.max(...along)) / 2;
  });
  camera.lookAt(x - ((left + right) / 2 - camera.width / 2) / scale,
    y + ((top + bottom) / 2 - camera.height / 2) / scale, scale);
}

// What has to be seen: the ego, those that it is told of, the other of an event, and where they meet.
function coreOf(app, view) {
  const core = [...cornersOf(app, view.ego), ...conflictsOf(view)];
  const others = new Set(view.named);
  if (view.event?.other >= 0) others.add(view.event.other);
  for (const vehicle of others) core.push(...cornersOf(app, view.states.get(vehicle)));
  if (view.event?.met) core.push(view.event.met);
  return core;
}

// Looks at what the ego is about: whom it may choose about and where it soon is, too, as long as that
// is still seen well; the ego alone where those named are too far away to be seen with it.
function frameEgo(app, view) {
  const { camera } = app;
  if (!view.ego) return;
  const core = coreOf(app, view), whole = core.slice();
  for (const vehicle of view.involved.keys()) {
    if (view.states.has(vehicle)) whole.push(...cornersOf(app, view.states.get(vehicle)));
  }
  for (const { points } of modesOf(view.ego)) whole.push(points[points.length - 1]);
  const rectangles = freeOf(app);
  const size = ([left, top, right, bottom]) => (right - left) * (bottom - top);
  for (const [points, least] of [[whole, FULL_SCALE], [core, FAR_SCALE], [cornersOf(app, view.ego), 0]]) {
    const fits = rectangles.map((one) => [scaleFor(points, one), size(one), one]);
    const best = Math.max(...fits.map((fit) => fit[0]));
    // The largest of those that show nearly as much: what is around is seen on all sides.
    const near = fits.filter((fit) => fit[0] >= 0.85 * best);
    const [scale, , rectangle] = near.reduce((a, b) => (b[1] > a[1] ? b : a));
    if (scale < least) continue;
    lookInto(camera, points, rectangle, scale);
    return;
  }
}

function freeOf({ free, camera }) {
  return free.length ? free : [[0, 0, camera.width, camera.height]];
}

// The least that a box on the screen has to be moved by to lie in a rectangle, away from its edges.
function shiftInto(box, rectangle) {
  return [0, 1].map((k) => {
    const room = rectangle[k + 2] - rectangle[k] - (box[k + 2] - box[k]);
    const edge = Math.min(CALM_PX, room / 2);
    return Math.max(rectangle[k] + edge - box[k], 0) + Math.min(rectangle[k + 2] - edge - box[k + 2], 0);
  });
}

// While the run goes on: the camera keeps clear what has to be seen, and moves, without haste, only
// where something of it gets near an edge or under what lies over the map. Where it follows the ego,
// it gives way from the ego for that, as far as the ego stays.
function attend(app, view, seconds, mayZoom) {
  const { camera } = app;
  if (!view.ego) { app.lead = null; return; }
  const gain = 1 - Math.exp(-seconds * Math.max(app.speed, 1) / CALM_S);
  const core = coreOf(app, view), rectangles = freeOf(app);
  if (mayZoom) {
    const fits = Math.max(...rectangles.map((one) => scaleFor(core, one)), LEAST_CALM_SCALE);
    // Closer again only where there is plenty of room, so that it does not go to and fro.
    const wanted = fits < camera.scale ? fits
      : fits > 1.3 * camera.scale ? Math.min(fits, app.openedAt) : camera.scale;
    camera.scale += (wanted - camera.scale) * gain;
  }
  const { scale, width, height } = camera;
  const from = app.following ? [view.ego.x, view.ego.y] : [camera.x, camera.y];
  const boxOf = (points) => {
    const [xs, ys] = [0, 1].map((k) => points.map((point) => point[k]));
    return [width / 2 + (Math.min(...xs) - from[0]) * scale, height / 2 - (Math.max(...ys) - from[1]) * scale,
      width / 2 + (Math.max(...xs) - from[0]) * scale, height / 2 - (Math.min(...ys) - from[1]) * scale];
  };
  const holds = ([left, top, right, bottom]) => ([a, b, c, d]) => c - a >= right - left && d - b >= bottom - top;
  let box = boxOf(core), room = rectangles.filter(holds(box));
  if (!room.length) { box = boxOf(cornersOf(app, view.ego)); room = rectangles.filter(holds(box)); }
  if (!room.length) room = rectangles;
  const shifts = room.map((one) => shiftInto(box, one));
  const [right, down] = shifts.reduce((a, b) => (Math.hypot(...b) < Math.hypot(...a) ? b : a));
  const to = [from[0] - right / scale, from[1] + down / scale];
  if (app.following) {
    // The camera keeps its place beside the ego while that changes.
    const lead = app.lead || [camera.x - from[0], camera.y - from[1]];
    app.lead = lead.map((one, k) => one + (to[k] - from[k] - one) * gain);
    camera.lookAt(from[0] + app.lead[0], from[1] + app.lead[1]);
  } else camera.lookAt(camera.x + (to[0] - from[0]) * gain, camera.y + (to[1] - from[1]) * gain);
}

// Where the ego meets those named; where its slots know none of them, all conflicts of its choice.
function conflictsOf(view) {
  const ahead = view.slots.filter((slot) => !slot.own && slot.focus && slot.conflict);
  const named = ahead.filter((slot) => view.named.includes(slot.vehicle));
  return (named.length ? named : ahead).map((slot) => slot.conflict);
}
