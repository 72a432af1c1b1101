import './app.css';

import { mount } from 'svelte';

import App from './App.svelte';
import { theme } from './lib/theme.svelte';

theme.start();

/** A stylesheet that did not arrive is asked for again after this time. */
const SHEET_MS = 3000;
// The script of a part of the page is loaded again with it, its sheet is not: the part would stay without its styles.
document.addEventListener(
  'error',
  ({ target }) => {
    if (target instanceof HTMLLinkElement && target.rel === 'stylesheet') setTimeout(() => target.replaceWith(target.cloneNode()), SHEET_MS);
  },
  true,
);

const target = document.getElementById('app');
if (!target) throw new Error('index.html has no #app');
mount(App, { target });
