//! Words for what is measured again at intervals.

use crate::lab::{Due, DueKind};
use crate::wording::utc_words;

/// States what is measured again, when it was last measured and when it is due.
pub fn words(due: &Due) -> String {
    let name = match (due.what, &due.part) {
        (DueKind::CheckStandard, Some(part)) => format!("check standard {part}"),
        (DueKind::CheckStandard, None) => "check standard".to_owned(),
        (DueKind::References, _) => "references".to_owned(),
    };
    let done = match due.what {
        DueKind::CheckStandard => "measured",
        DueKind::References => "taken",
    };
    match (&due.last_at, &due.due_at) {
        (Some(last_at), Some(due_at)) => {
            let since = if due.is_due { "since " } else { "" };
            let (last_at, due_at) = (utc_words(last_at), utc_words(due_at));
            format!("{name}: last {done} {last_at}, due {since}{due_at}")
        }
        _ => format!("{name}: never {done}, due now"),
    }
}

/// States what to do where it is due.
pub fn advice(due: &Due) -> String {
    match &due.part {
        Some(part) => {
            format!("measure {part} and look at its control chart: ridged chart --part {part:?}")
        }
        None => "take dark frames and the white reference: ridged scan --preset full --calibrate, or Calibrate only on the page".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_state_when_it_was_measured_and_when_it_is_due() {
        let standard = Due {
            what: DueKind::CheckStandard,
            part: Some("CS-1".into()),
            last_at: Some("2026-03-02T09:00:00.000Z".into()),
            due_at: Some("2026-03-09T09:00:00.000Z".into()),
            is_due: false,
        };
        let text = "check standard CS-1: last measured 2026-03-02 09:00:00 UTC, due 2026-03-09 09:00:00 UTC";
        assert_eq!(words(&standard), text);
        let late = Due {
            is_due: true,
            ..standard.clone()
        };
        assert_eq!(words(&late), text.replace("due ", "due since "));
        assert!(advice(&late).ends_with("ridged chart --part \"CS-1\""));
        let never = Due {
            what: DueKind::References,
            part: None,
            last_at: None,
            due_at: None,
            is_due: true,
        };
        assert_eq!(words(&never), "references: never taken, due now");
        assert!(advice(&never).contains("--calibrate"));
    }
}
