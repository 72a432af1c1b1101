// Files that are sent with a request: their content as base64, and their largest size.

import { bytes } from './format';

/** Largest body of a request, bytes. The daemon refuses a larger one unread. */
const BODY_BYTES_MAX = 8 << 20;
/** Share of it for everything else: the text of a scene, names, numbers. */
const REST_BYTES = 1 << 16;
/** Largest total size of the files of one request, bytes. Base64 makes four bytes of three. */
export const FILES_BYTES_MAX = 3 * Math.floor((BODY_BYTES_MAX - REST_BYTES) / 4);

/** Why files cannot be sent with one request, or null. */
export function sizeProblem(files: readonly { readonly name: string; readonly size: number }[]): string | null {
  const empty = files.find((f) => f.size === 0);
  if (empty) return `${empty.name} is empty.`;
  const size = files.reduce((sum, f) => sum + f.size, 0);
  if (size <= FILES_BYTES_MAX) return null;
  const [who, have] = files.length === 1 ? [files[0]?.name ?? 'The file', 'has'] : ['These files', 'have'];
  return `${who} ${have} ${bytes(size)}; a request may have ${bytes(FILES_BYTES_MAX)}. Crop or subsample the heights, or send them as a compressed 16-bit TIFF or PNG.`;
}

/** A file's content as base64, as requests carry it. */
export function base64(file: Blob): Promise<string> {
  return new Promise((resolve, reject) => {
    const reader = new FileReader();
    // A data URL: media type, a comma, the content.
    reader.onload = () => resolve(String(reader.result).replace(/^[^,]*,/, ''));
    reader.onerror = () => reject(new Error('The file cannot be read. It was moved or changed after it was chosen; choose it again.'));
    reader.readAsDataURL(file);
  });
}
