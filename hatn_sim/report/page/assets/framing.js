// Where the camera looks when a moment is opened: at the ego, those that its advice and alerts name
// and where they meet, in the part of the map that nothing lies over.

const EDGE_PX = 26; // kept free around what is looked at
const CLOSE_SCALE = 8, FULL_SCALE = 5, FAR_SCALE = 1.3; // CSS pixels per metre
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

// Looks at what the ego is about: whom it may choose about and where it soon is, too, as long as that
// is still seen well; the ego alone where those named are too far away to be seen with it.
function frameEgo(app, view, covers) {
  const { camera } = app;
  if (!view.ego) return;
  const core = [...cornersOf(app, view.ego), ...conflictsOf(view)];
  for (const vehicle of view.named) core.push(...cornersOf(app, view.states.get(vehicle)));
  const whole = core.slice();
  for (const vehicle of view.involved.keys()) {
    if (view.states.has(vehicle)) whole.push(...cornersOf(app, view.states.get(vehicle)));
  }
  for (const { points } of modesOf(view.ego)) whole.push(points[points.length - 1]);
  const rectangles = freeRectangles(camera.width, camera.height, covers);
  if (!rectangles.length) rectangles.push([0, 0, camera.width, camera.height]);
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

// Where the ego meets those named; where its slots know none of them, all conflicts of its choice.
function conflictsOf(view) {
  const ahead = view.slots.filter((slot) => !slot.own && slot.focus && slot.conflict);
  const named = ahead.filter((slot) => view.named.includes(slot.vehicle));
  return (named.length ? named : ahead).map((slot) => slot.conflict);
}
