// Builds the documents that the page links to: `docs/**/*.md` becomes `dist/docs/**/*.html`, so that the program serves them offline.
// Only documents that a card names are built. A link between two of them is kept, a link to any other file becomes plain text,
// and pictures are left out, because the program carries every byte.

import { readdirSync, readFileSync } from 'node:fs';
import { join, posix, resolve } from 'node:path';

import { Marked, type Tokens } from 'marked';
import type { Plugin } from 'vite';

const DOCS = resolve(import.meta.dirname, '../docs');
const SOURCES = resolve(import.meta.dirname, 'src');
const STYLE = resolve(import.meta.dirname, 'documents.css');

/** The anchor of a heading, as mkdocs makes it for the site of the documents. */
export function slug(heading: string): string {
  return heading.normalize('NFKC').toLowerCase().replace(/[^\p{L}\p{N}_\s-]/gu, '').trim().replace(/[-\s]+/g, '-');
}

/** Where the cards of the page link to: paths below `docs/`, with anchors. */
export function linkedDocuments(folder = SOURCES): string[] {
  const files = readdirSync(folder, { recursive: true, encoding: 'utf8' }).filter((name) => name.endsWith('.svelte'));
  const links = files.flatMap((name) => [...readFileSync(join(folder, name), 'utf8').matchAll(/['"]((?:[a-z-]+\/)?[a-z-]+\.html(?:#[^'"]*)?)['"]/g)].map(([, to = '']) => to));
  return [...new Set(links)].sort();
}

const escaped = (text: string): string => text.replaceAll('&', '&amp;').replaceAll('<', '&lt;').replaceAll('>', '&gt;').replaceAll('"', '&quot;');
/** A text without its marks, for the title and the anchors. */
const bare = (text: string): string => text.replace(/<[^>]*>/g, '').replaceAll('&amp;', '&').replaceAll('&lt;', '<').replaceAll('&gt;', '>').replaceAll('&quot;', '"').replaceAll('&#39;', "'");

interface Document {
  readonly title: string;
  readonly html: string;
  readonly anchors: readonly string[];
}

/** Renders the document at `path`, such as `how-to/queue.md`. `built` are the documents that links may lead to. */
export function render(path: string, markdown: string, built: ReadonlySet<string>): Document {
  const anchors: string[] = [];
  let title = path;
  const up = '../'.repeat(path.split('/').length - 1);
  const marked = new Marked({
    renderer: {
      heading({ tokens, depth }: Tokens.Heading): string {
        const words = this.parser.parseInline(tokens);
        if (depth === 1) title = bare(words);
        let id = slug(bare(words));
        for (let n = 1; anchors.includes(id); n++) id = `${slug(bare(words))}_${n}`;
        anchors.push(id);
        return `<h${depth} id="${id}">${words}</h${depth}>\n`;
      },
      link({ href, tokens }: Tokens.Link): string {
        const words = this.parser.parseInline(tokens);
        if (/^https?:/.test(href)) return `<a href="${escaped(href)}" rel="noopener">${words}</a>`;
        if (href.startsWith('#')) return `<a href="${escaped(href)}">${words}</a>`;
        const [file = '', anchor] = href.split('#');
        const target = posix.normalize(posix.join(posix.dirname(path), file));
        return built.has(target) ? `<a href="${up}${target.replace(/\.md$/, '.html')}${anchor === undefined ? '' : `#${escaped(anchor)}`}">${words}</a>` : words;
      },
      image: ({ text }: Tokens.Image): string => (text === '' ? '' : `<em>${escaped(text)}</em>`),
      code: ({ text }: Tokens.Code): string => `<pre tabindex="0"><code>${escaped(text)}\n</code></pre>\n`,
      table(token: Tokens.Table): string {
        const row = (cells: readonly Tokens.TableCell[], tag: string): string => `<tr>${cells.map((cell) => `<${tag}>${this.parser.parseInline(cell.tokens)}</${tag}>`).join('')}</tr>\n`;
        return `<div class="wide" tabindex="0" role="group" aria-label="Table">\n<table>\n<thead>${row(token.header, 'th')}</thead>\n<tbody>${token.rows.map((cells) => row(cells, 'td')).join('')}</tbody>\n</table></div>\n`;
      },
    },
  });
  return { html: marked.parse(markdown, { async: false }), title, anchors };
}

function sheet(title: string, body: string, up: string): string {
  return `<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>${escaped(title)} · ridged</title>\n<link rel="stylesheet" href="${up}style.css">\n</head>\n<body>\n<nav aria-label="Documents"><a href="${up}index.html">All help</a></nav>\n<main>\n${body}</main>\n</body>\n</html>\n`;
}

/** All files below `docs/` of the page, by their paths. Fails on a link to a document or an anchor that does not exist. */
export function documents(links = linkedDocuments()): Map<string, string> {
  const paths = [...new Set(links.map((link) => (link.split('#')[0] ?? '').replace(/\.html$/, '.md')))];
  const built = new Set(paths);
  const pages = new Map(paths.map((path) => [path, render(path, readFileSync(join(DOCS, path), 'utf8'), built)]));
  for (const link of links) {
    const [path = '', anchor] = link.split('#');
    if (anchor !== undefined && !pages.get(path.replace(/\.html$/, '.md'))?.anchors.includes(anchor)) throw new Error(`a card links to docs/${link}: there is no heading with this anchor in docs/${path.replace(/\.html$/, '.md')}`);
  }
  const files = new Map([['style.css', readFileSync(STYLE, 'utf8')]]);
  for (const [path, { title, html }] of pages) files.set(path.replace(/\.md$/, '.html'), sheet(title, html, '../'.repeat(path.split('/').length - 1)));
  const list = [...pages].sort(([, a], [, b]) => a.title.localeCompare(b.title)).map(([path, { title }]) => `<li><a href="${path.replace(/\.md$/, '.html')}">${escaped(title)}</a></li>\n`);
  files.set('index.html', sheet('Help', `<h1>Help</h1>\n<ul>\n${list.join('')}</ul>\n`, ''));
  return files;
}

/** Adds the documents to the build, and answers them while developing. */
export function helpDocuments(): Plugin {
  return {
    name: 'ridged-documents',
    generateBundle() {
      for (const [path, source] of documents()) this.emitFile({ type: 'asset', fileName: `docs/${path}`, source });
    },
    configureServer(server) {
      server.middlewares.use('/docs', (request, response, next) => {
        const path = (request.url ?? '').replace(/^\//, '').split('?')[0] ?? '';
        const file = documents().get(path);
        if (file === undefined) return next();
        response.setHeader('content-type', path.endsWith('.css') ? 'text/css' : 'text/html; charset=utf-8');
        response.end(file);
      });
    },
  };
}
