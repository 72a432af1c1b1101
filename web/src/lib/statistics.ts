// Statistics of a few values with uncertainties.

/** Complementary error function, to 1e-14 of its value: a series below 2.5, a continued fraction above (Abramowitz and Stegun 7.1.6, 7.1.14). */
export function erfc(z: number): number {
  if (z < 2.5) {
    let [term, sum] = [z, z];
    for (let n = 1; n < 200 && Math.abs(term) > 1e-17 * Math.abs(sum); n++) {
      term *= (2 * z * z) / (2 * n + 1);
      sum += term;
    }
    return 1 - (2 / Math.sqrt(Math.PI)) * Math.exp(-z * z) * sum;
  }
  let fraction = z;
  for (let n = 80; n >= 1; n--) fraction = z + n / 2 / fraction;
  return Math.exp(-z * z) / (Math.sqrt(Math.PI) * fraction);
}

/** Probability that a standard normal variable is below z. */
export const normalBelow = (z: number): number => (z > 0 ? 1 - 0.5 * erfc(z / Math.SQRT2) : 0.5 * erfc(-z / Math.SQRT2));

/** Probability that chi-square with whole degrees of freedom is at least this large. */
export function chiSquareTail(chiSquare: number, degreesOfFreedom: number): number {
  const x = Math.max(0, chiSquare) / 2;
  // Q(a + 1, x) = Q(a, x) + x^a e^-x / Γ(a + 1), from Q(1, x) = e^-x and Q(1/2, x) = erfc √x (DLMF 8.8.6).
  const odd = degreesOfFreedom % 2 === 1;
  let tail = odd ? erfc(Math.sqrt(x)) : Math.exp(-x);
  let term = odd ? Math.exp(-x) * Math.sqrt(x / Math.PI) * 2 : Math.exp(-x) * x;
  for (let a = odd ? 0.5 : 1; a < degreesOfFreedom / 2; a++) {
    tail += term;
    term *= x / (a + 1);
  }
  return Math.min(1, tail);
}

export const mean = (values: readonly number[]): number => values.reduce((sum, x) => sum + x, 0) / values.length;

/** Standard deviation of single values, N − 1 in the denominator. */
export function deviation(values: readonly number[]): number {
  const centre = mean(values);
  return Math.sqrt(values.reduce((sum, x) => sum + (x - centre) ** 2, 0) / (values.length - 1));
}

export interface Consistency {
  readonly mean: number;
  /** Standard deviation of a single value. */
  readonly deviation: number;
  /** Root mean square of the standard uncertainties. */
  readonly stated: number;
  /** About the weighted mean; null where a standard uncertainty is zero. */
  readonly chiSquare: number | null;
  readonly degreesOfFreedom: number;
  /** Probability of a chi-square at least this large. */
  readonly probability: number | null;
}

/** Scatter of at least two values beside their standard uncertainties. */
export function consistency(values: readonly { readonly value: number; readonly std: number }[]): Consistency {
  const degreesOfFreedom = values.length - 1;
  const known = values.every((v) => v.std > 0);
  const weights = values.map((v) => 1 / v.std ** 2);
  const total = weights.reduce((sum, w) => sum + w, 0);
  const centre = values.reduce((sum, v, i) => sum + v.value * (weights[i] ?? 0), 0) / total;
  const chiSquare = known ? values.reduce((sum, v, i) => sum + (v.value - centre) ** 2 * (weights[i] ?? 0), 0) : null;
  return {
    mean: mean(values.map((v) => v.value)),
    deviation: deviation(values.map((v) => v.value)),
    stated: Math.sqrt(mean(values.map((v) => v.std ** 2))),
    chiSquare,
    degreesOfFreedom,
    probability: chiSquare === null ? null : chiSquareTail(chiSquare, degreesOfFreedom),
  };
}
