// Colours of flow and of errors; the definitions are `srflow_core::flow_colors` and `srflow_report`'s heat map.

/** Middlebury's colour wheel (Baker et al., IJCV 2011), 55 colours of 0 to 1. */
const WHEEL = (() => {
  const corners = [[1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1], [1, 0, 1]];
  return [15, 6, 4, 11, 13, 6].flatMap((steps, corner) => {
    const [from, to] = [corners[corner], corners[(corner + 1) % 6]];
    return Array.from({ length: steps }, (_, step) => {
      const part = Math.floor((255 * step) / steps) / 255;
      return from.map((x, channel) => x + part * (to[channel] - x));
    });
  });
})();

/** The colour, 0 to 255, of a flow in units of the length that has full saturation. */
function flowColor(u, v) {
  if (!(Number.isFinite(u) && Number.isFinite(v))) return [0, 0, 0];
  const radius = Math.hypot(u, v);
  if (radius === 0) return [255, 255, 255];
  const place = ((Math.atan2(-v, -u) / Math.PI + 1) / 2) * (WHEEL.length - 1);
  const before = Math.min(Math.floor(place), WHEEL.length - 1);
  const after = (before + 1) % WHEEL.length;
  const part = place - before;
  return [0, 1, 2].map((channel) => {
    const hue = (1 - part) * WHEEL[before][channel] + part * WHEEL[after][channel];
    return Math.floor(255 * (radius <= 1 ? 1 - radius * (1 - hue) : 0.75 * hue));
  });
}

/** Ten equidistant colours of matplotlib's `inferno` (CC0). */
const HEAT = [
  [0, 0, 4], [27, 12, 65], [74, 12, 107], [120, 28, 109], [165, 44, 96], [207, 68, 70], [237, 105, 37], [251, 155, 6],
  [247, 209, 61], [252, 255, 164],
];

/** The colour, 0 to 255, of a share of the range; grey where there is none. */
function heatColor(share) {
  if (Number.isNaN(share)) return [150, 150, 152];
  const place = Math.min(Math.max(share, 0), 1) * (HEAT.length - 1);
  const below = Math.min(Math.floor(place), HEAT.length - 2);
  const rest = place - below;
  return [0, 1, 2].map((c) => Math.floor(HEAT[below][c] * (1 - rest) + HEAT[below + 1][c] * rest + 0.5));
}
