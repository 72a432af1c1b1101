//! Hands that do an operator step before the scan says that it waits for it: those of a simulated rig. A client that confirms the
//! step at once cannot be faster than they are.

use std::sync::{Arc, Mutex};

use tokio::sync::{mpsc, oneshot};

use crate::lab::{Lab, LabError};
use crate::scan::OperatorAction;

/// A step to be done.
#[derive(Debug)]
pub struct OperatorCall {
    /// The scan that will wait.
    pub scan_id: i64,
    /// What to do.
    pub action: OperatorAction,
    done: oneshot::Sender<()>,
}

impl OperatorCall {
    /// Reports that the step is done. Dropping the call does the same.
    pub fn done(self) {
        self.done.send(()).ok();
    }
}

/// Where the hands listen, if there are any.
#[derive(Debug, Clone, Default)]
pub(in crate::lab) struct Hands {
    calls: Arc<Mutex<Option<mpsc::Sender<OperatorCall>>>>,
}

impl Hands {
    /// Has a step done, and returns when it is.
    pub(in crate::lab) async fn act(&self, scan_id: i64, action: OperatorAction) {
        let calls = {
            let calls = self.calls.lock().expect("no holder of this lock panics");
            calls.clone()
        };
        let Some(calls) = calls else { return };
        let (done, is_done) = oneshot::channel();
        let call = OperatorCall {
            scan_id,
            action,
            done,
        };
        // Hands that have gone do nothing.
        if calls.send(call).await.is_ok() {
            is_done.await.ok();
        }
    }
}

impl Lab {
    /// Returns the operator steps of all scans from now on. Each scan waits until its step is reported done.
    ///
    /// # Errors
    /// [`LabError::NoRig`].
    pub fn operator_calls(&self) -> Result<mpsc::Receiver<OperatorCall>, LabError> {
        let (sender, receiver) = mpsc::channel(1);
        let hands = &self.side()?.hands;
        *hands.calls.lock().expect("no holder of this lock panics") = Some(sender);
        Ok(receiver)
    }
}
