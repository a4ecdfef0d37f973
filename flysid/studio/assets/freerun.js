// Free runs of models over a changed input: the same recursions, in the same order, as flysid's own.

// `recursion` as the server gives it; `u` (N, n_u) from the segment's start; returns (N - first, n_y).
export function freeRun(recursion, u, n_y) {
  return recursion.kind === "linear" ? linear(recursion, u, n_y) : rules(recursion, u, n_y);
}

function linear({ a, b, c, u_origin, y_origin, limits, before }, u, n_y) {
  const first = before.length, dy = before.map((row) => row.map((value, i) => value - y_origin[i]));
  for (let k = first; k < u.length; k++) {
    const next = new Array(n_y);
    for (let i = 0; i < n_y; i++) {
      let value = c[i];
      for (let lag = 0; lag < b.length && lag <= k; lag++) {
        for (let j = 0; j < u_origin.length; j++) { value += b[lag][i][j] * (u[k - lag][j] - u_origin[j]); }
      }
      for (let lag = 1; lag < a.length && lag <= k; lag++) {
        for (let j = 0; j < n_y; j++) { value -= a[lag][i][j] * dy[k - lag][j]; }
      }
      next[i] = value;
    }
    dy.push(next);
  }
  return dy.slice(first).map((row) => row.map((value, i) => clamp(value + y_origin[i], limits[0][i], limits[1][i])));
}

function rules({ lags, theta, centre, width, z_range, limits, shift, scale, before }, u, n_y) {
  const n = theta[0].length, first = before.length, count = theta.length;
  const W = u.map((row, k) => {
    const known = k < first ? before[k].slice(0, n) : new Array(n).fill(0);
    return known.concat(row.map((value, j) => (value - shift[n + j]) / scale[n + j]));
  });
  const x = new Array(lags.column.length), z = new Array(lags.z_lag.length), phi = new Array(count);
  for (let k = first; k < W.length; k++) {
    for (let m = 0; m < x.length; m++) { x[m] = lags.column[m] < 0 ? 1 : W[k - lags.lag[m]][lags.column[m]]; }
    for (let j = 0; j < z.length; j++) {
      let value = W[k - lags.z_lag[j]][lags.z_column[j]];
      if (lags.z_minus[j] >= 0) { value -= W[k - lags.z_minus[j]][lags.z_column[j]]; }
      z[j] = Math.min(Math.max(value, z_range[0][j]), z_range[1][j]);
    }
    let top = -1e300, total = 0;
    for (let r = 0; r < count; r++) {
      let log = 0;
      for (let j = 0; j < z.length; j++) {
        const d = (z[j] - centre[r][j]) / width[r][j];
        log -= 0.5 * d * d;
      }
      phi[r] = log;
      top = Math.max(top, log);
    }
    for (let r = 0; r < count; r++) {
      const gap = phi[r] - top;
      phi[r] = gap > -40 ? Math.exp(gap) : 0;
      total += phi[r];
    }
    for (let i = 0; i < n; i++) {
      let value = 0;
      for (let r = 0; r < count; r++) {
        const share = total > 0 ? phi[r] / total : 1 / count;
        if (share > 0) {
          let part = 0;
          for (let m = 0; m < x.length; m++) { part += theta[r][i][m] * x[m]; }
          value += share * part;
        }
      }
      W[k][i] = clamp(value, limits[0][i], limits[1][i]);
    }
  }
  return W.slice(first).map((row) => row.slice(0, n_y).map((value, i) => value * scale[i] + shift[i]));
}

function clamp(value, low, high) {
  return value > low ? Math.min(value, high) : low;
}
