// Perceptually uniform colours, built as in the daemon's pictures (src/colour.rs): in the OKLCh space
// (B. Ottosson 2020), equal steps in value are equal steps in lightness.

export type Rgb = readonly [number, number, number];
export type Palette = 'diverging' | 'sequential' | 'cyclic';

/** Steps of a table; odd, so that zero has a colour of its own. */
export const STEPS = 257;

/** STEPS × 3 bytes from the lowest value to the highest. In the dark theme a diverging map is dark at zero, like the background. */
export function perceptual(palette: Palette, dark: boolean): Uint8Array {
  const table = new Uint8Array(STEPS * 3);
  for (let i = 0; i < STEPS; i++) table.set(colourAt(palette, i / (STEPS - 1), dark), 3 * i);
  return table;
}

function colourAt(palette: Palette, fraction: number, dark: boolean): Rgb {
  if (palette === 'cyclic') return inGamut(0.72, 0.115, 360 * fraction + 25);
  if (palette === 'sequential') return inGamut(0.24 + 0.69 * fraction, 0.17, 295 - 190 * fraction);
  const signed = 2 * fraction - 1;
  const strength = Math.abs(signed);
  const lightness = dark ? 0.36 + 0.46 * strength : 0.98 - 0.56 * strength;
  return inGamut(lightness, (dark ? 0.17 : 0.19) * strength, signed < 0 ? 255 : 28);
}

/** The colour of a lightness and hue with the largest chroma up to the given one that a screen can show. */
function inGamut(lightness: number, chroma: number, hueDeg: number): Rgb {
  const fits = (c: number): boolean => linearRgb(lightness, c, hueDeg).every((x) => x >= -1e-4 && x <= 1.0001);
  let [low, high] = [0, chroma];
  if (fits(chroma)) low = chroma;
  else {
    for (let i = 0; i < 30; i++) {
      const middle = 0.5 * (low + high);
      if (fits(middle)) low = middle;
      else high = middle;
    }
  }
  const [r, g, b] = linearRgb(lightness, low, hueDeg).map((x) => Math.round(255 * gamma(Math.min(1, Math.max(0, x)))));
  return [r ?? 0, g ?? 0, b ?? 0];
}

/** OKLCh to linear sRGB. */
function linearRgb(lightness: number, chroma: number, hueDeg: number): Rgb {
  const hue = (hueDeg * Math.PI) / 180;
  const [a, b] = [chroma * Math.cos(hue), chroma * Math.sin(hue)];
  const l = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (lightness - 0.0894841775 * a - 1.291485548 * b) ** 3;
  return [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ];
}

/** The transfer function of sRGB (IEC 61966-2-1). */
function gamma(x: number): number {
  return x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055;
}

/** CSS gradient of a table, lowest value at the left. */
export function gradient(table: Uint8Array): string {
  const stops: string[] = [];
  for (let i = 0; i < STEPS; i += 16) stops.push(`rgb(${table[3 * i]} ${table[3 * i + 1]} ${table[3 * i + 2]})`);
  return `linear-gradient(to right, ${stops.join(', ')})`;
}
