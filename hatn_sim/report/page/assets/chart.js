// The ego's speed over time: driven, predicted, advised; from some seconds ago to some ahead.

const CHART = { before: 5, after: 5, height: 128, left: 26, right: 8, top: 8, bottom: 20 };
const WAY_S = 0.5; // between way points of a prediction, and between advised speeds

// What the chart draws, in seconds from now and m/s.
function speedsAround(app, view) {
  const { head, store } = app;
  const at = (frame) => {
    const state = frame < 0 || frame >= head.frames ? null : stateAt(store, head, frame, app.ego);
    return state && [(frame - app.frame) * head.dt_s, state.speed];
  };
  const driven = [];
  const steps = (seconds) => Math.round(seconds / head.dt_s);
  for (let frame = view.frame - steps(CHART.before); frame <= view.frame + steps(CHART.after); frame++) {
    driven.push(at(frame));
  }
  const logged = view.logged.get(app.ego);
  const since = (view.frame - app.frame) * head.dt_s; // of the prediction, made at a frame of the log
  const predicted = !logged ? [] : modesOf(logged).map(({ chance, points }) => ({
    chance,
    points: points.slice(1).map(([x, y], i) =>
      [since + (i + 0.5) * WAY_S, Math.hypot(x - points[i][0], y - points[i][1]) / WAY_S]),
  }));
  const said = view.advice;
  const advised = !said || !said.speeds ? [] : said.speeds.map((tenths, i) =>
    [app.timeOf(said.frame) + (i + 1) * WAY_S - view.time, tenths / 10]);
  return { driven, predicted, advised };
}

function drawSpeeds(canvas, app, view) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, { height } = CHART;
  if (!width) return;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const ctx = canvas.getContext('2d');
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  const style = getComputedStyle(document.documentElement);
  const [ink, soft, faint, pink] = ['--ink', '--soft', '--line', '--predicted'].map((name) => style.getPropertyValue(name));
  const { driven, predicted, advised } = speedsAround(app, view);
  const everything = [...driven.filter(Boolean), ...advised, ...predicted.flatMap(({ points }) => points)];
  const most = Math.max(8, ...everything.map(([, speed]) => speed)) * 1.08;
  const x = (s) => CHART.left + ((s + CHART.before) / (CHART.before + CHART.after)) * (width - CHART.left - CHART.right);
  const y = (mps) => height - CHART.bottom - (mps / most) * (height - CHART.top - CHART.bottom);
  ctx.font = '11px system-ui, sans-serif';
  ctx.textBaseline = 'middle';
  ctx.textAlign = 'right';
  const step = [2, 5, 10, 20].find((one) => most / one <= 4.5) || 50;
  for (let mps = 0; mps <= most; mps += step) {
    ctx.fillStyle = faint;
    ctx.fillRect(CHART.left, Math.round(y(mps)), width - CHART.left - CHART.right, 1);
    ctx.fillStyle = soft;
    ctx.fillText(String(mps), CHART.left - 5, y(mps));
  }
  ctx.textAlign = 'center';
  for (const s of [-4, -2, 0, 2, 4]) {
    ctx.fillStyle = s ? soft : ink;
    ctx.fillText(s ? `${s > 0 ? '+' : '\u2212'}${Math.abs(s)} s` : 'now', x(s), height - 8);
  }
  ctx.save();
  ctx.beginPath();
  ctx.rect(CHART.left, 0, width - CHART.left - CHART.right, height - CHART.bottom + 2);
  ctx.clip();
  ctx.lineJoin = 'round';
  const stroke = (points, colour, thick, dash = []) => {
    ctx.beginPath();
    let down = false;
    for (const point of points) {
      if (point) { if (down) ctx.lineTo(x(point[0]), y(point[1])); else ctx.moveTo(x(point[0]), y(point[1])); }
      down = Boolean(point);
    }
    ctx.setLineDash(dash);
    ctx.strokeStyle = colour;
    ctx.lineWidth = thick;
    ctx.stroke();
    ctx.setLineDash([]);
  };
  for (const { chance, points } of [...predicted].reverse()) {
    ctx.globalAlpha = 0.25 + 0.75 * chance;
    stroke(points, pink, 4);
    ctx.globalAlpha = 1;
  }
  stroke(advised, ACTION_COLOURS[view.advice?.action] || soft, 3, [6, 3]);
  stroke(driven.filter((point) => !point || point[0] <= 1e-6), ink, 2);
  stroke(driven.filter((point) => !point || point[0] >= -0.1), ink, 1.2);
  ctx.restore();
  ctx.fillStyle = ink;
  ctx.fillRect(x(0) - 0.5, CHART.top - 4, 1, height - CHART.top - CHART.bottom + 6);
  if (view.ego) {
    ctx.beginPath();
    ctx.arc(x(0), y(view.ego.speed), 3.5, 0, 2 * Math.PI);
    ctx.fill();
  }
}
