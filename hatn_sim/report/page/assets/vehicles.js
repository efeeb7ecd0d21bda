// Vehicles from above, in metres of their own frame: x forward, y left.

const MATERIALS = { cargo: '#d8dadb', glass: '#1c242c', light: '#fff6d8', dark: '#23272c' };
const AMBER = '#ffb000';

function rounded(path, back, front, width, corner) {
  path.roundRect(back, -width / 2, front - back, width, Math.min(corner, width / 2, (front - back) / 2));
}

function disc(path, x, radius) {
  path.moveTo(x + radius, 0);
  path.arc(x, 0, radius, 0, 2 * Math.PI);
}

function polygon(path, points) {
  addPoints(path, points);
  path.closePath();
}

function outlineOf(vehicle, grow) {
  const path = new Path2D();
  const length = vehicle.length_m + 2 * grow, width = vehicle.width_m + 2 * grow;
  const corner = Math.min(0.34 * vehicle.width_m, 0.45 * vehicle.length_m) + grow;
  rounded(path, -length / 2, length / 2, width, corner);
  return path;
}

// What a vehicle is drawn of, from the ground up: [material, path].
function partsOf({ kind, length_m: length, width_m: width }) {
  const half = length / 2, parts = [];
  const add = (material, draw) => {
    const path = new Path2D();
    draw(path);
    parts.push([material, path]);
  };
  const lamps = () => add('light', (path) => {
    for (const side of [1, -1]) {
      const y = (offset) => side * (width / 2 - 0.38 - offset);
      polygon(path, [[half - 0.42, y(-0.2)], [half - 0.16, y(-0.24)], [half - 0.1, y(0.18)],
        [half - 0.3, y(0.2)]]);
    }
  });
  if (kind === 'pedestrian') {
    add('body', (path) => disc(path, 0, 0.35));
    add('dark', (path) => disc(path, 0.05, 0.17));
    return parts;
  }
  if (kind === 'motorcycle' || kind === 'bicycle') {
    add('dark', (path) => rounded(path, -half, half, 0.42 * width, 0.21 * width));
    add('dark', (path) => rounded(path, 0.18 * length, 0.18 * length + 0.16, width, 0.08));
    add('body', (path) => rounded(path, -0.16 * length, 0.06 * length, 0.74 * width, 0.24));
    add('glass', (path) => disc(path, -0.03 * length, 0.2));
    return parts;
  }
  const body = () => add('body', (path) =>
    rounded(path, -half, half, width, Math.min(0.34 * width, 0.45 * length)));
  if (kind === 'lorry' && length > 5) {
    const cab = Math.min(2.3, 0.35 * length);
    add('body', (path) => rounded(path, half - cab, half, 0.94 * width, 0.35));
    lamps();
    add('glass', (path) => polygon(path, [[half - 0.85, 0.37 * width], [half - 0.3, 0.43 * width],
      [half - 0.3, -0.43 * width], [half - 0.85, -0.37 * width]]));
    add('cargo', (path) => rounded(path, -half, half - cab - 0.2, width, 0.18));
    return parts;
  }
  body();
  lamps();
  if (kind === 'bus' || kind === 'tram') {
    add('glass', (path) => rounded(path, -half + 0.25, half - 0.2, 0.9 * width, 0.4));
    add('body', (path) => rounded(path, -half + 0.6, half - 0.9, 0.76 * width, 0.3));
  } else if (kind === 'van' || kind === 'lorry') {
    add('glass', (path) => rounded(path, -0.1 * length, 0.36 * length, 0.84 * width, 0.35));
    add('body', (path) => rounded(path, -0.44 * length, 0.22 * length, 0.74 * width, 0.3));
  } else {
    add('glass', (path) => rounded(path, -0.38 * length, 0.22 * length, 0.82 * width, 0.5));
    add('body', (path) => rounded(path, -0.27 * length, 0.06 * length, 0.68 * width, 0.3));
  }
  return parts;
}

// Shapes are made once for each vehicle.
function vehicleShapes(vehicles) {
  const made = new Map();
  return (index) => {
    if (!made.has(index)) {
      const vehicle = vehicles[index];
      made.set(index, {
        parts: partsOf(vehicle),
        shadow: outlineOf(vehicle, 0.12),
        rings: [0.34, 0.48, 0.62, 1.1].map((grow) => outlineOf(vehicle, grow)),
      });
    }
    return made.get(index);
  };
}

function placed(ctx, camera, state, draw) {
  ctx.save();
  ctx.translate(state.x, state.y);
  ctx.rotate(state.yaw);
  draw();
  ctx.restore();
}

// One vehicle; `ring`: colour of its halo or null, `faded`: it has nothing to do with the ego.
function drawVehicle(ctx, camera, state, shapes, vehicle, { ring, isEgo, faded, lit, look }) {
  if (camera.scale < 1.2) { // from far away: a dot that can be seen
    ctx.fillStyle = isEgo ? '#ffffff' : ring || `rgb(${vehicle.colour.join(',')})`;
    ctx.beginPath();
    ctx.arc(state.x, state.y, Math.max(1.2, (isEgo ? 5 : 3) / camera.scale), 0, 2 * Math.PI);
    ctx.fill();
    if (isEgo) { ctx.strokeStyle = look.ink; ctx.lineWidth = 1.5 / camera.scale; ctx.stroke(); }
    return;
  }
  ctx.save();
  ctx.translate(0.32, -0.36);
  placed(ctx, camera, state, () => {
    ctx.fillStyle = 'rgba(12,15,20,0.3)';
    ctx.fill(shapes.shadow);
  });
  ctx.restore();
  placed(ctx, camera, state, () => {
    if (isEgo) {
      ctx.fillStyle = look.ink;
      ctx.fill(shapes.rings[2]);
      ctx.fillStyle = '#ffffff';
      ctx.fill(shapes.rings[1]);
    } else if (ring) {
      ctx.fillStyle = ring;
      ctx.fill(shapes.rings[0]);
    }
    ctx.lineWidth = 0.06;
    ctx.strokeStyle = 'rgba(0,0,0,0.6)';
    for (const [material, path] of shapes.parts) {
      ctx.fillStyle = MATERIALS[material] || `rgb(${vehicle.colour.join(',')})`;
      ctx.fill(path);
      ctx.stroke(path);
      if (faded) { // into the asphalt
        ctx.globalAlpha = 0.3;
        ctx.fillStyle = look.asphalt;
        ctx.fill(path);
        ctx.globalAlpha = 1;
      }
    }
    if (state.blinker && lit) drawBlinker(ctx, vehicle, state.blinker);
  });
}

function drawBlinker(ctx, vehicle, side) {
  const x = vehicle.length_m / 2 - 0.22, y = side * (vehicle.width_m / 2 - 0.16);
  for (const [radius, alpha] of [[0.58, 0.25], [0.38, 0.4], [0.21, 1]]) {
    ctx.fillStyle = AMBER;
    ctx.globalAlpha = alpha;
    for (const end of [x, -x]) {
      ctx.beginPath();
      ctx.arc(end, y, radius, 0, 2 * Math.PI);
      ctx.fill();
    }
  }
  ctx.globalAlpha = 1;
}
