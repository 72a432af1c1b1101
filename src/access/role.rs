//! Roles: each one may do what the one before it may.

use std::str::FromStr;

use crate::words::words;

words! {
    /// What the holder of a token may do. Every role may stop the rig.
    #[derive(PartialOrd, Ord, utoipa::ToSchema)]
    pub enum Role {
        /// Reads, and stops the rig.
        Viewer = "viewer",
        /// Also computes: fits, maps, contrasts, verdicts, traces; adds samples and imports series.
        Analyst = "analyst",
        /// Also moves the rig and runs scans.
        Operator = "operator",
        /// Also accepts exchanged devices of the rig.
        Admin = "admin",
    }
}

impl FromStr for Role {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        Role::from_word(word)
            .ok_or_else(|| format!("expected viewer, analyst, operator or admin, got `{word}`"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_role_may_do_what_the_one_before_it_may() {
        assert!(Role::ALL.windows(2).all(|pair| pair[0] < pair[1]));
        for role in Role::ALL {
            assert_eq!(role.as_str().parse(), Ok(role));
        }
        assert!("root".parse::<Role>().is_err());
    }
}
