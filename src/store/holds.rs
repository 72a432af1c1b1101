//! Holds on frame files that a row is about to name, so that no other task deletes them.
//!
//! Two imports may bring the same content, which is one file. An import that fails may delete the file only if the other
//! has not named it in a row and is not about to.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Held files by content hash.
#[derive(Debug, Default)]
pub(super) struct Holds {
    held: Mutex<HashMap<String, Held>>,
}

#[derive(Debug, Default)]
struct Held {
    holders: usize,
    /// Whether another task took a hold after [`Holds::watch`].
    taken_since: bool,
}

impl Holds {
    fn held(&self) -> MutexGuard<'_, HashMap<String, Held>> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a hold on a file. Take it before checking whether the file exists.
    pub fn take(self: &Arc<Self>, sha256: &str) -> Hold {
        let mut all = self.held();
        let held = all.entry(sha256.to_owned()).or_default();
        held.holders += 1;
        held.taken_since = true;
        Hold {
            holds: Arc::clone(self),
            sha256: sha256.to_owned(),
        }
    }

    /// Returns whether only the `own` holds are left on the file, and starts to watch for new holds.
    pub fn watch(&self, sha256: &str, own: usize) -> bool {
        match self.held().get_mut(sha256) {
            Some(held) if held.holders == own => {
                held.taken_since = false;
                true
            }
            _ => false,
        }
    }

    /// Calls `delete` if no task took a hold since [`Holds::watch`]; no task can take one meanwhile.
    pub fn if_untouched(&self, sha256: &str, delete: impl FnOnce()) {
        let all = self.held();
        if all.get(sha256).is_some_and(|held| !held.taken_since) {
            delete();
        }
    }
}

/// A hold on a file: while it exists, other tasks do not delete the file.
#[derive(Debug)]
pub(super) struct Hold {
    holds: Arc<Holds>,
    sha256: String,
}

impl Clone for Hold {
    fn clone(&self) -> Self {
        self.holds.take(&self.sha256)
    }
}

impl PartialEq for Hold {
    fn eq(&self, other: &Self) -> bool {
        self.sha256 == other.sha256
    }
}

impl Drop for Hold {
    fn drop(&mut self) {
        let mut all = self.holds.held();
        if let Some(held) = all.get_mut(&self.sha256) {
            held.holders -= 1;
            if held.holders == 0 {
                all.remove(&self.sha256);
            }
        }
    }
}
