// Forecasts of jobs in words.

import { count, percent, seconds } from './format';
import type { Forecast } from './types';

/** A forecast: `about 4.2 s for 108 poses: 1.2 s to read and reduce, 3.0 s to fit`. */
export function foretold(forecast: Forecast): string {
  const { count: drawn, error: reached } = forecast.at_limit ?? {};
  const atLimit = drawn == null ? '' : ` (about ${count(drawn)} at the limit)`;
  const amount = forecast.amount ? ` for ${count(forecast.amount.count)} ${forecast.amount.of}${atLimit}` : '';
  const parts = (forecast.parts ?? []).map((part) => `${seconds(part.seconds)} ${part.what}`).join(', ');
  const error = forecast.error ? `; error of ${forecast.error.of.replace(/,$/, '')} about ${percent(forecast.error.value)}${reached == null ? '' : ` (${percent(reached)} at the limit)`}` : '';
  const uncut = forecast.uncut_seconds;
  const short = forecast.cut_short && uncut == null ? ' (the time limit is too short for all of it)' : '';
  const about = forecast.at_most ? 'at most' : 'about';
  const cut = uncut == null ? '' : `stops at the ${seconds(forecast.seconds)} limit; all of it takes `;
  return `${cut}${about} ${seconds(uncut ?? forecast.seconds)}${amount}${parts ? `: ${parts}` : ''}${error}${short}`;
}
