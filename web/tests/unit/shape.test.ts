import { describe, expect, it } from 'vitest';

import { FILES_BYTES_MAX, sizeProblem } from '../../src/lib/files';
import { heightUnitOf, pitchOf, shapeProblem, shapeRequest } from '../../src/lib/shape';

describe('files of one request', () => {
  it('fit into its body as base64, to the byte', () => {
    // The daemon accepts 8 MiB; 64 kB of it are for everything else.
    expect((4 * FILES_BYTES_MAX) / 3).toBeLessThanOrEqual(8 * 1024 * 1024 - 65_536);
    expect((4 * (FILES_BYTES_MAX + 3)) / 3).toBeGreaterThan(8 * 1024 * 1024 - 65_536);
    expect(sizeProblem([{ name: 'a.tif', size: FILES_BYTES_MAX }])).toBeNull();
    expect(sizeProblem([{ name: 'a.tif', size: FILES_BYTES_MAX + 1 }])).toMatch(/^a\.tif has 6\.2 MB; a request may have 6\.2 MB\. Crop/);
  });

  it('are summed, and an empty one is named', () => {
    const half = { name: 'a.tif', size: FILES_BYTES_MAX - 10 };
    expect(sizeProblem([half, { name: 'b.tif', size: 11 }])).toMatch(/^These files have/);
    expect(sizeProblem([half, { name: 'b.tif', size: 0 }])).toBe('b.tif is empty.');
    expect(sizeProblem([])).toBeNull();
  });
});

describe('a measured shape', () => {
  it('accepts one pitch or two, with decimal points or commas', () => {
    expect(['0.5', '0,5', '5e-1', ' 2 ', ''].map(pitchOf)).toEqual([0.5, 0.5, 0.5, 2, null]);
    for (const text of ['0.5,0.6', '0,5 0,6', '0.5 × 0.6', '0,5;0,6', '0.5x0.6']) expect(pitchOf(text), text).toEqual([0.5, 0.6]);
  });

  it('refuses a partly typed pitch, three numbers, or one that is not a length', () => {
    for (const text of ['0', '-1', '1 2 3', '0.5,', '0.5 µm', '1 0', 'x', '1e999']) expect(pitchOf(text), text).toBeNaN();
    expect(['', '0,001', '0', 'µm'].map(heightUnitOf)).toEqual([null, 0.001, Number.NaN, Number.NaN]);
  });

  it('is refused by its extension or size before it is sent', () => {
    expect(shapeProblem({ name: 'MAP.TIF', size: 10 })).toBeNull();
    expect(shapeProblem({ name: 'map.sur', size: 10 })).toMatch(/^map\.sur is not a height file\. Supported extensions: \.csv/);
    expect(shapeProblem({ name: 'map.x3p', size: 7e6 })).toMatch(/^map\.x3p has 7\.0 MB/);
  });

  it('sends only the given units', () => {
    expect(shapeRequest('a.x3p', 'AA==', { pitch: '', unit: ' ' })).toEqual({ name: 'a.x3p', content: 'AA==' });
    expect(shapeRequest('a.tif', 'AA==', { pitch: '0,5 0,6', unit: '1e-3' })).toEqual({ name: 'a.tif', content: 'AA==', pitch_um: [0.5, 0.6], height_unit_um: 0.001 });
  });
});
