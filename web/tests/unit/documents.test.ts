// The documents that the page's build makes of docs/.

import { posix } from 'node:path';

import { describe, expect, it } from 'vitest';

import { documents, linkedDocuments, render, slug } from '../../documents';

describe('the documents of the page', () => {
  const files = documents();

  it('have no link that leads nowhere', () => {
    for (const [path, text] of files) {
      for (const [, href = ''] of text.matchAll(/ href="([^"]*)"/g)) {
        if (/^https?:/.test(href)) continue;
        const [file = '', anchor] = href.split('#');
        const target = file === '' ? path : posix.join(posix.dirname(path), file);
        expect(files.has(target), `${path}: ${href}`).toBe(true);
        if (anchor !== undefined) expect(files.get(target), `${path}: ${href}`).toContain(` id="${anchor}"`);
      }
    }
  });

  it('are those that cards link to, and take less than 120 kB of the program', () => {
    const linked = new Set(linkedDocuments().map((link) => link.split('#')[0]));
    expect(linked.size).toBeGreaterThan(10);
    expect(new Set(files.keys())).toEqual(new Set([...linked, 'index.html', 'style.css']));
    expect([...files.values()].reduce((sum, text) => sum + Buffer.byteLength(text), 0)).toBeLessThan(120_000);
  });

  it('fail the build where a card links to an anchor that does not exist', () => {
    expect(() => documents(['reference/page.html#no-such-card'])).toThrow('there is no heading with this anchor in docs/reference/page.md');
    expect(() => documents(['reference/no-such-page.html'])).toThrow('no-such-page.md');
  });

  it('keep links among themselves, and only the words of others', () => {
    const { html, anchors, title } = render('how-to/a.md', '# A & `b`\n\n[c](../reference/c.md#x) [d](d.md) [web](https://example.org) ![p](p.png)\n\n## Gauge R&R\n## Gauge R&R\n', new Set(['reference/c.md']));
    expect(html).toContain('<a href="../reference/c.html#x">c</a> d <a href="https://example.org" rel="noopener">web</a> <em>p</em>');
    expect(title).toBe('A & b');
    expect(anchors).toEqual(['a-b', 'gauge-rr', 'gauge-rr_1']);
  });

  it('have the anchors of the site of the documents', () => {
    expect([slug('3. Choose the part and start'), slug('`[[interface]]`'), slug('HTTP (`/api/v1`)'), slug('Größe – U')]).toEqual(['3-choose-the-part-and-start', 'interface', 'http-apiv1', 'größe-u']);
  });
});
