// Files that go out with a request: their content as base64, and how large they may be.

import { bytes } from './format';

/** What the body of a request may have, bytes: the daemon refuses a larger one unread. */
const BODY_BYTES_MAX = 8 << 20;
/** Of it for everything that is no file: the text of a scene, names, numbers. */
const REST_BYTES = 1 << 16;
/** What the files of one request may have together, bytes: base64 makes four of three. */
export const FILES_BYTES_MAX = 3 * Math.floor((BODY_BYTES_MAX - REST_BYTES) / 4);

/** Why files cannot go out with one request, or null. */
export function sizeProblem(files: readonly { readonly name: string; readonly size: number }[]): string | null {
  const empty = files.find((f) => f.size === 0);
  if (empty) return `${empty.name} is empty.`;
  const size = files.reduce((sum, f) => sum + f.size, 0);
  if (size <= FILES_BYTES_MAX) return null;
  const [who, have] = files.length === 1 ? [files[0]?.name ?? 'The file', 'has'] : ['These files', 'have'];
  return `${who} ${have} ${bytes(size)}, and a request takes ${bytes(FILES_BYTES_MAX)}: crop or thin out the heights, or send them as a compressed 16-bit TIFF or PNG.`;
}

/** A file's content as base64, as requests carry it. */
export function base64(file: Blob): Promise<string> {
  return new Promise((resolve, reject) => {
    const reader = new FileReader();
    // A data URL: what it is, a comma, the content.
    reader.onload = () => resolve(String(reader.result).replace(/^[^,]*,/, ''));
    reader.onerror = () => reject(new Error('The file cannot be read: it was moved or changed since it was chosen. Choose it again.'));
    reader.readAsDataURL(file);
  });
}
