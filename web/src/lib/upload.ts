// Sends a recorded series as a zip archive. `fetch` reports no progress of a body, so this uses XMLHttpRequest.

import { ownHeaders, PREFIX } from './api';
import { noAnswer, problemOf } from './problems';
import type { Imported } from './types';

/** Sends an archive and waits until it is imported. `progress` gets the share that has been sent. */
export function sendArchive(archive: File, skipUnreadable: boolean, progress: (share: number) => void): Promise<Imported> {
  const query = new URLSearchParams({ name: archive.name, skip_unreadable: String(skipUnreadable) });
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open('POST', `${PREFIX}/imports/upload?${query.toString()}`);
    ownHeaders({ 'content-type': 'application/zip' }).forEach((value, name) => request.setRequestHeader(name, value));
    request.responseType = 'json';
    request.upload.onprogress = ({ loaded, total }) => progress(loaded / Math.max(1, total));
    request.onload = () => {
      if (request.status < 300) resolve(request.response as Imported);
      else reject(problemOf(request.status, request.response, `the daemon answered ${request.status} ${request.statusText}`));
    };
    request.onerror = () => reject(noAnswer());
    request.send(archive);
  });
}
