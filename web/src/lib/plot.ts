// The plotting library and its style, which are read with the first plot.

import 'uplot/dist/uPlot.min.css';

export { default } from 'uplot';
