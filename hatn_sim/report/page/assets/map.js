// The map: a camera over it, the road, and what is drawn in metres.

const LOOKS = {
  light: {
    verge: '#e8eae1', kerb: '#c9cac3', shoulder: '#dcddd4', asphalt: '#62676d', path: '#d3d0c6',
    rail: '#9a9a94', paint: '#eceae4', ink: '#22262b', paper: '#fbfaf7', soft: '#6b7178',
    predicted: '#ff5a86', actual: '#ffffff', closed: '#e5484d', open: '#46a758',
    leader: '#22262b',
  },
  dark: {
    verge: '#15191c', kerb: '#39403f', shoulder: '#1f2526', asphalt: '#3a4047', path: '#2b2e2c',
    rail: '#5b5f5e', paint: '#b9bab4', ink: '#0b0d0f', paper: '#14171a', soft: '#9aa1a8',
    predicted: '#ff6f97', actual: '#ffffff', closed: '#ff6369', open: '#4cc38a',
    leader: '#d8d6d0',
  },
};
// Viridis from a little above its dark end, as in the figures: safe for the colour-blind.
const VIRIDIS = [
  [70, 23, 103], [68, 57, 131], [56, 88, 140], [44, 114, 142], [33, 145, 140],
  [40, 174, 128], [94, 201, 98], [173, 220, 48], [253, 231, 37],
];
const ALARM = '#ff3b30';
const LEAST_SCALE = 0.02, MOST_SCALE = 60; // CSS pixels per metre

function chanceColour(chance, alpha = 1) {
  const at = Math.min(Math.max(chance, 0), 1) * (VIRIDIS.length - 1);
  const i = Math.min(Math.floor(at), VIRIDIS.length - 2), part = at - i;
  const mix = VIRIDIS[i].map((low, k) => Math.round(low + part * (VIRIDIS[i + 1][k] - low)));
  return `rgba(${mix.join(',')},${alpha})`;
}

function mapCamera(canvas) {
  const camera = { x: 0, y: 0, scale: 8, width: 1, height: 1, ratio: 1 };
  camera.resize = () => {
    camera.ratio = Math.min(window.devicePixelRatio || 1, 2);
    camera.width = Math.max(canvas.clientWidth, 1);
    camera.height = Math.max(canvas.clientHeight, 1);
    canvas.width = Math.round(camera.width * camera.ratio);
    canvas.height = Math.round(camera.height * camera.ratio);
  };
  camera.toScreen = (x, y) => [
    camera.width / 2 + (x - camera.x) * camera.scale,
    camera.height / 2 - (y - camera.y) * camera.scale,
  ];
  camera.toMap = (x, y) => [
    camera.x + (x - camera.width / 2) / camera.scale,
    camera.y - (y - camera.height / 2) / camera.scale,
  ];
  camera.zoom = (factor, x = camera.width / 2, y = camera.height / 2) => {
    const [mapX, mapY] = camera.toMap(x, y);
    camera.scale = Math.min(Math.max(camera.scale * factor, LEAST_SCALE), MOST_SCALE);
    camera.x = mapX - (x - camera.width / 2) / camera.scale;
    camera.y = mapY + (y - camera.height / 2) / camera.scale;
  };
  camera.pan = (dx, dy) => {
    camera.x -= dx / camera.scale;
    camera.y += dy / camera.scale;
  };
  camera.lookAt = (x, y, scale = camera.scale) => {
    Object.assign(camera, { x, y, scale });
  };
  camera.fit = ([west, south, east, north]) => {
    const across = Math.max(east - west, 20), up = Math.max(north - south, 20);
    const scale = 0.94 * Math.min(camera.width / across, camera.height / up);
    camera.lookAt((west + east) / 2, (south + north) / 2,
      Math.min(Math.max(scale, LEAST_SCALE), MOST_SCALE));
  };
  camera.sees = (x, y, marginM) =>
    Math.abs(x - camera.x) < camera.width / 2 / camera.scale + marginM
    && Math.abs(y - camera.y) < camera.height / 2 / camera.scale + marginM;
  // Metres, y up.
  camera.inMetres = (ctx) => {
    const k = camera.ratio * camera.scale;
    ctx.setTransform(k, 0, 0, -k, camera.ratio * camera.width / 2 - k * camera.x,
      camera.ratio * camera.height / 2 + k * camera.y);
  };
  camera.inPixels = (ctx) => ctx.setTransform(camera.ratio, 0, 0, camera.ratio, 0, 0);
  return camera;
}

function addFlat(path, xy, perM) {
  for (let i = 0; i < xy.length; i += 2) {
    if (i) path.lineTo(xy[i] / perM, xy[i + 1] / perM);
    else path.moveTo(xy[0] / perM, xy[1] / perM);
  }
}

function addPoints(path, points) {
  points.forEach(([x, y], i) => (i ? path.lineTo(x, y) : path.moveTo(x, y)));
}

// The road as a few paths: one for each use and width of lanes.
function roadPaths(road) {
  const strips = new Map();
  const bounds = [Infinity, Infinity, -Infinity, -Infinity];
  for (const lane of road.lanes) {
    const key = `${lane.use} ${lane.width_m} ${lane.joins}`;
    if (!strips.has(key)) {
      // Round ends, hidden under the lanes they join, fill the wedges where those turn.
      const cap = lane.joins ? 'round' : 'butt';
      strips.set(key, { use: lane.use, width: lane.width_m, cap, path: new Path2D() });
    }
    addFlat(strips.get(key).path, lane.xy, PER_M);
    for (let i = 0; i < lane.xy.length; i += 2) {
      bounds[0] = Math.min(bounds[0], lane.xy[i] / PER_M);
      bounds[1] = Math.min(bounds[1], lane.xy[i + 1] / PER_M);
      bounds[2] = Math.max(bounds[2], lane.xy[i] / PER_M);
      bounds[3] = Math.max(bounds[3], lane.xy[i + 1] / PER_M);
    }
  }
  const lines = (list) => {
    const path = new Path2D();
    for (const xy of list) addFlat(path, xy, PER_M);
    return path;
  };
  return {
    bounds: road.lanes.length ? bounds : null,
    strips: [...strips.values()],
    solid: lines(road.solid),
    dashed: lines(road.dashed),
    stops: road.stops.map((stop) => ({ ...stop, path: stopPath(stop) })),
  };
}

// A bar where one has to stop; teeth, which point at those who have to give way.
function stopPath(stop) {
  const path = new Path2D();
  const corner = (i) => [stop.xy[2 * i] / PER_M, stop.xy[2 * i + 1] / PER_M];
  if (stop.xy.length < 8) return path;
  const [frontLeft, frontRight, , backLeft] = [corner(0), corner(1), corner(2), corner(3)];
  if (stop.gate !== 'give_way_line') {
    addFlat(path, stop.xy, PER_M);
    path.closePath();
    return path;
  }
  const mix = (a, b, part) => [a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])];
  const back = [backLeft[0] - frontLeft[0], backLeft[1] - frontLeft[1]];
  for (let k = 0; k < 5; k++) {
    const tip = mix(frontLeft, frontRight, (k + 0.5) / 5);
    addPoints(path, [
      mix(frontLeft, frontRight, (k + 0.12) / 5), mix(frontLeft, frontRight, (k + 0.88) / 5),
      [tip[0] + 1.6 * back[0], tip[1] + 1.6 * back[1]],
    ]);
    path.closePath();
  }
  return path;
}

function drawRoad(ctx, camera, paths, look) {
  camera.inMetres(ctx);
  ctx.lineJoin = 'round';
  ctx.lineCap = 'butt';
  const thinnest = 1.2 / camera.scale; // a lane is never thinner than this on the screen
  const stroke = (use, grow, colour) => {
    ctx.strokeStyle = colour;
    for (const strip of paths.strips) {
      if (strip.use !== use) continue;
      ctx.lineWidth = Math.max(strip.width + grow, thinnest);
      ctx.lineCap = strip.cap;
      ctx.stroke(strip.path);
    }
  };
  stroke('path', 0, look.path);
  stroke('road', 1.1, look.shoulder);
  stroke('road', 0.56, look.kerb);
  stroke('road', 0, look.asphalt);
  ctx.lineCap = 'butt';
  for (const strip of paths.strips.filter((one) => one.use === 'tram')) {
    ctx.strokeStyle = look.rail;
    ctx.lineWidth = 1.6;
    ctx.stroke(strip.path);
    ctx.strokeStyle = look.verge;
    ctx.lineWidth = 1.3;
    ctx.stroke(strip.path);
  }
  if (camera.scale < 1.2) return;
  ctx.strokeStyle = ctx.fillStyle = look.paint;
  ctx.globalAlpha = 0.6;
  ctx.lineWidth = 0.12;
  ctx.stroke(paths.solid);
  ctx.globalAlpha = 0.8;
  ctx.setLineDash([3, 3]);
  ctx.stroke(paths.dashed);
  ctx.setLineDash([]);
  for (const stop of paths.stops) ctx.fill(stop.path);
  ctx.globalAlpha = 1;
}

// The road as a picture somewhat larger than the view: it is painted anew only where the camera has
// left it, zoomed, or the looks are others.
function groundOf(paths) {
  const canvas = document.createElement('canvas');
  let painted = null;
  const room = 0.25; // beyond each side of the view, as a share of it
  return (ctx, camera, look) => {
    const { width, height, scale, ratio } = camera;
    const stale = !painted || painted.look !== look || painted.scale !== scale || painted.ratio !== ratio
      || painted.width !== width || painted.height !== height
      || Math.abs(camera.x - painted.x) * scale > room * width
      || Math.abs(camera.y - painted.y) * scale > room * height;
    if (stale) {
      painted = { x: camera.x, y: camera.y, width, height, scale, ratio, look };
      const wide = mapCamera(canvas);
      Object.assign(wide, painted, { width: width * (1 + 2 * room), height: height * (1 + 2 * room) });
      canvas.width = Math.round(wide.width * ratio);
      canvas.height = Math.round(wide.height * ratio);
      const ground = canvas.getContext('2d');
      ground.fillStyle = look.verge;
      ground.fillRect(0, 0, canvas.width, canvas.height);
      drawRoad(ground, wide, paths, look);
    }
    camera.inPixels(ctx);
    ctx.drawImage(canvas, (painted.x - camera.x) * scale - room * width,
      (camera.y - painted.y) * scale - room * height, canvas.width / ratio, canvas.height / ratio);
    camera.inMetres(ctx);
  };
}

// Stop lines of signals in the colour of the signal now, and a lamp behind each: a disc with a bar
// where it is closed, a ring where it is open, for those who see no difference of red and green.
function drawSignals(ctx, camera, paths, closed, look) {
  for (const stop of paths.stops) {
    if (stop.gate !== 'signal' || !stop.signals.length) continue;
    if (Math.max(...stop.signals) >= closed.length) continue;
    const isClosed = stop.signals.every((link) => closed[link]);
    ctx.fillStyle = ctx.strokeStyle = isClosed ? look.closed : look.open;
    ctx.fill(stop.path);
    if (camera.scale < 3 || stop.xy.length < 8) continue;
    const [x, y, alongX, alongY] = lampOf(stop.xy);
    ctx.beginPath();
    ctx.arc(x, y, 0.62, 0, 2 * Math.PI);
    if (isClosed) {
      ctx.fill();
      ctx.fillStyle = '#ffffff';
      ctx.beginPath();
      ctx.moveTo(x - 0.4 * alongX, y - 0.4 * alongY);
      ctx.lineTo(x + 0.4 * alongX, y + 0.4 * alongY);
      ctx.strokeStyle = '#ffffff';
    } else {
      ctx.fillStyle = look.ink;
      ctx.fill();
    }
    ctx.lineWidth = 0.26;
    ctx.stroke();
  }
}

// The middle of a lamp, a metre behind the middle of its stop line, and the way along the line.
function lampOf(xy) {
  const [leftX, leftY, rightX, rightY] = xy.map((one) => one / PER_M);
  const [backX, backY] = [xy[6] / PER_M - leftX, xy[7] / PER_M - leftY];
  const across = Math.hypot(rightX - leftX, rightY - leftY) || 1, deep = Math.hypot(backX, backY) || 1;
  return [
    (leftX + rightX) / 2 + (1.1 * backX) / deep, (leftY + rightY) / 2 + (1.1 * backY) / deep,
    (rightX - leftX) / across, (rightY - leftY) / across,
  ];
}
