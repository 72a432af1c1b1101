import { svelte } from '@sveltejs/vite-plugin-svelte';
import { defineConfig } from 'vitest/config';

import { helpDocuments } from './documents.ts';

export default defineConfig({
  plugins: [svelte(), helpDocuments()],
  // The daemon serves the page at its root; relative paths keep it movable.
  base: './',
  // A browser of this target that does not preload modules still loads them, so the first view does not carry the polyfill.
  build: {
    target: 'es2023',
    outDir: 'dist',
    emptyOutDir: true,
    assetsInlineLimit: 0,
    reportCompressedSize: true,
    modulePreload: { polyfill: false },
    // The first view has the names of all parts; six characters of a hash are enough for the versions of one of them.
    rollupOptions: { output: { chunkFileNames: 'assets/[name]-[hash:6].js', assetFileNames: 'assets/[name]-[hash:6][extname]' } },
  },
  // The daemon only answers its own page, so requests that `npm run dev` forwards must not name another origin.
  server: {
    proxy: {
      '/api': {
        target: process.env['RIDGED_URL'] ?? 'http://127.0.0.1:8787',
        changeOrigin: true,
        configure: (proxy) => proxy.on('proxyReq', (request) => request.removeHeader('origin')),
      },
    },
  },
  test: {
    projects: [
      { extends: true, test: { name: 'unit', include: ['tests/unit/**/*.test.ts'], environment: 'node' } },
      // The others drive headless Chromium; each file starts its own servers on loopback ports, that of the day uses a running one.
      { extends: true, test: { name: 'page', include: ['tests/page/**/*.test.ts'], environment: 'node', testTimeout: 60_000, hookTimeout: 60_000 } },
      { extends: true, test: { name: 'e2e', include: ['tests/e2e/**/*.test.ts'], environment: 'node', testTimeout: 240_000, hookTimeout: 60_000, fileParallelism: false } },
      { extends: true, test: { name: 'day', include: ['tests/day/**/*.test.ts'], environment: 'node', hookTimeout: 60_000 } },
      { extends: true, test: { name: 'screenshot', include: ['tests/screenshot/**/*.test.ts'], environment: 'node', testTimeout: 480_000, hookTimeout: 60_000 } },
    ],
  },
});
