//! Who is about to name a frame file in a row, so that nobody deletes it meanwhile.
//!
//! Two imports may bring the same content: one file. If one of them fails, it may delete the file
//! only where the other neither has named it in a row nor is about to.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Files that are held, by their content hash.
#[derive(Debug, Default)]
pub(super) struct Holds {
    held: Mutex<HashMap<String, Held>>,
}

#[derive(Debug, Default)]
struct Held {
    holders: usize,
    /// Whether somebody took hold of it after [`Holds::watch`].
    taken_since: bool,
}

impl Holds {
    fn held(&self) -> MutexGuard<'_, HashMap<String, Held>> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Holds a file; to be taken before looking whether it is there.
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

    /// Whether nobody but the `own` holds has the file; from now on it is noticed who takes it.
    pub fn watch(&self, sha256: &str, own: usize) -> bool {
        match self.held().get_mut(sha256) {
            Some(held) if held.holders == own => {
                held.taken_since = false;
                true
            }
            _ => false,
        }
    }

    /// Does `delete` if nobody took hold of the file since it was watched; nobody can meanwhile.
    pub fn if_untouched(&self, sha256: &str, delete: impl FnOnce()) {
        let all = self.held();
        if all.get(sha256).is_some_and(|held| !held.taken_since) {
            delete();
        }
    }
}

/// Keeps a file from being deleted by others, as long as it is there.
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
