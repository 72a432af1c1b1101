//! Which lines of the budgets of several scans have the same error in all of them, by the records of these scans.
//!
//! A line counts as shared only where the records show it. Otherwise the errors count as independent, which makes the
//! uncertainty of a difference too large rather than too small.

use serde::Serialize;

use crate::fit::report::VariantName;
use crate::fit::uncertainty::budget::Budget;
use crate::wording::meant;

/// How a scan was measured, as far as it decides which errors it has in common with others.
#[derive(Debug, Clone, PartialEq)]
pub struct Circumstances {
    /// Number of the part.
    pub sample_id: i64,
    /// Variant of the model.
    pub variant: VariantName,
    /// Number of the rig with its settings; none for an import.
    pub rig_id: Option<i64>,
    /// Poses θc, φs of the sample in the plan, degrees, ascending.
    pub poses_deg: Vec<[f64; 2]>,
    /// Exposure times of the plan, s.
    pub exposures_s: Vec<f64>,
    /// The white reference, if the scan has one.
    pub white_reference: Option<WhiteReferenceOf>,
}

/// The white reference of a scan.
#[derive(Debug, Clone, PartialEq)]
pub struct WhiteReferenceOf {
    /// Its reflectance.
    pub reflectance: Option<f64>,
    /// Standard uncertainty of the reflectance.
    pub reflectance_std: Option<f64>,
    /// Certificate, as it is stated.
    pub certificate: Option<String>,
    /// Numbers of the calibrations with its frames.
    pub calibration_ids: Vec<i64>,
    /// SHA-256 of its frames, ascending.
    pub frames_sha256: Vec<String>,
}

/// A line of the budget, and whether it has the same error in all scans.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct SharedLine {
    /// Key of the line.
    #[schema(value_type = String)]
    pub line: &'static str,
    /// Whether its error is the same in all scans.
    pub shared: bool,
    /// Why.
    pub why: String,
}

impl SharedLine {
    /// Whether the line has the same error in all scans for this parameter. The zeros of the stages depend on how a part
    /// is laid down, whatever else the line of the angles contains.
    #[must_use]
    pub fn holds_for(&self, parameter: &str) -> bool {
        let is_zero = ["azimuth_offset_deg", "tilt_offset_deg"].contains(&parameter);
        self.shared && !(self.line == "angles" && is_zero)
    }
}

/// Which lines count as shared.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum SharedChoice {
    /// Those that the records of the scans show.
    #[default]
    Recorded,
    /// These, by the caller's knowledge.
    Stated(Vec<&'static str>),
}

/// Keys of the lines of a budget.
#[must_use]
pub fn lines() -> [&'static str; 12] {
    Budget::default().named().map(|(line, _)| line)
}

impl SharedChoice {
    /// Reads keys of lines separated by commas, or `none`.
    ///
    /// # Errors
    /// A key that is not a line, with what was probably meant.
    pub fn read(text: &str) -> Result<SharedChoice, String> {
        if text.trim() == "none" {
            return Ok(SharedChoice::Stated(Vec::new()));
        }
        let known = lines();
        let all = text.split(',').map(|word| {
            let word = word.trim();
            let found = known.iter().find(|line| **line == word);
            found.copied().ok_or_else(|| {
                let short: String = word.chars().take(40).collect();
                let hint = match meant(word, &known) {
                    Some(line) => format!("did you mean `{line}`?"),
                    None => format!("expected none, or some of {}", known.join(", ")),
                };
                format!("there is no line {short:?} in a budget; {hint}")
            })
        });
        all.collect::<Result<_, _>>().map(SharedChoice::Stated)
    }
}

/// Decides for every line of the budgets.
#[must_use]
pub fn decided(all: &[&Circumstances], choice: &SharedChoice) -> Vec<SharedLine> {
    let decide = |line: &'static str| {
        let (shared, why) = match choice {
            SharedChoice::Recorded => recorded(all, line),
            SharedChoice::Stated(lines) if lines.contains(&line) => {
                (true, "stated for this evaluation".to_owned())
            }
            SharedChoice::Stated(_) => (false, "not among the lines stated as the same".to_owned()),
        };
        SharedLine { line, shared, why }
    };
    lines().map(decide).to_vec()
}

fn recorded(all: &[&Circumstances], line: &str) -> (bool, String) {
    let same = |key: fn(&Circumstances, &Circumstances) -> bool| {
        all.split_first()
            .is_some_and(|(first, rest)| rest.iter().all(|other| key(first, other)))
    };
    let part = same(|a, b| a.sample_id == b.sample_id);
    let poses = same(|a, b| a.poses_deg == b.poses_deg);
    let exposures = same(|a, b| a.exposures_s == b.exposures_s);
    let rig = same(|a, b| a.rig_id.is_some() && a.rig_id == b.rig_id);
    let variant = same(|a, b| a.variant == b.variant);
    let all_of = |needs: &[(bool, &str)], shared: &str| {
        let missing = needs.iter().find(|(holds, _)| !holds);
        match missing {
            Some((_, why)) => (false, (*why).to_owned()),
            None => (true, shared.to_owned()),
        }
    };
    match line {
        "reference" => reference(all),
        "angles" => all_of(
            &[
                (
                    rig,
                    "the scans are not of one rig with unchanged settings in this store",
                ),
                (poses, "the scans have different poses"),
            ],
            "same rig with unchanged settings, same poses",
        ),
        "material" => all_of(
            &[(
                part,
                "different parts: their indices of refraction may differ",
            )],
            "same part",
        ),
        "detector" => all_of(
            &[
                (
                    rig,
                    "the scans are not of one rig with unchanged settings in this store",
                ),
                (part, "different parts: their signals differ"),
                (
                    poses && exposures,
                    "the scans have different poses or exposures",
                ),
            ],
            "same rig and part, same poses and exposures",
        ),
        "model" => all_of(
            &[
                (part, "different parts"),
                (variant, "the fits have different models"),
                (poses, "the scans have different poses"),
            ],
            "same part, model and poses",
        ),
        _ => (false, "independent in each scan".to_owned()),
    }
}

fn reference(all: &[&Circumstances]) -> (bool, String) {
    let references: Option<Vec<&WhiteReferenceOf>> =
        all.iter().map(|c| c.white_reference.as_ref()).collect();
    let Some((first, rest)) = references.as_ref().and_then(|r| r.split_first()) else {
        return (false, "not every scan has a white reference".to_owned());
    };
    let common = first
        .calibration_ids
        .iter()
        .find(|id| rest.iter().all(|other| other.calibration_ids.contains(id)));
    if let Some(id) = common {
        return (
            true,
            format!("all scans used the white-reference frames of calibration {id}"),
        );
    }
    let equal = rest.iter().all(|other| {
        (other.reflectance, other.reflectance_std) == (first.reflectance, first.reflectance_std)
    });
    // Copies of a series, imported apart, have no calibration in common.
    let has_frames = !first.frames_sha256.is_empty();
    let same_frames = |other: &&WhiteReferenceOf| other.frames_sha256 == first.frames_sha256;
    if equal && has_frames && rest.iter().all(same_frames) {
        return (
            true,
            "all scans used the same white-reference frames".to_owned(),
        );
    }
    let Some(certificate) = first.certificate.as_deref() else {
        return (
            false,
            "the certificate is not stated (flat.certificate): the white references may differ"
                .to_owned(),
        );
    };
    match equal
        && rest
            .iter()
            .all(|other| other.certificate.as_deref() == Some(certificate))
    {
        true => (
            true,
            format!("all scans used the white reference of certificate {certificate}"),
        ),
        false => (false, "the white references differ".to_owned()),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn circumstances() -> Circumstances {
        Circumstances {
            sample_id: 1,
            variant: VariantName::Sawtooth,
            rig_id: Some(3),
            poses_deg: vec![[-10.0, 0.0], [-10.0, 90.0], [0.0, 0.0]],
            exposures_s: vec![0.01],
            white_reference: Some(WhiteReferenceOf {
                reflectance: Some(0.99),
                reflectance_std: Some(0.005),
                certificate: None,
                calibration_ids: vec![4],
                frames_sha256: vec!["a4".to_owned()],
            }),
        }
    }

    fn shared(a: &Circumstances, b: &Circumstances) -> Vec<&'static str> {
        let lines = decided(&[a, b], &SharedChoice::Recorded);
        let all = lines.iter().filter(|line| line.shared);
        all.map(|line| line.line).collect()
    }

    #[test]
    fn only_what_the_records_show_is_shared() {
        let a = circumstances();
        let all = ["reference", "angles", "material", "detector", "model"];
        assert_eq!(shared(&a, &a), all);
        let mut b = circumstances();
        b.sample_id = 2;
        assert_eq!(shared(&a, &b), ["reference", "angles"]);
        b = circumstances();
        b.poses_deg.push([0.0, 90.0]);
        assert_eq!(shared(&a, &b), ["reference", "material"]);
        b = circumstances();
        b.rig_id = None;
        assert_eq!(shared(&a, &b), ["reference", "material", "model"]);
        // Two imports do not show that they are of one rig.
        assert_eq!(shared(&b, &b), ["reference", "material", "model"]);
        b = circumstances();
        b.variant = VariantName::Paper;
        assert_eq!(
            shared(&a, &b),
            ["reference", "angles", "material", "detector"]
        );
    }

    #[test]
    fn a_white_reference_is_the_same_by_its_frames_or_its_certificate() {
        let a = circumstances();
        let with = |certificate: Option<&str>, calibration: i64| {
            let mut b = circumstances();
            let reference = b.white_reference.as_mut().unwrap();
            reference.certificate = certificate.map(str::to_owned);
            reference.calibration_ids = vec![calibration];
            reference.frames_sha256 = vec![format!("a{calibration}")];
            b
        };
        assert!(!shared(&a, &with(None, 5)).contains(&"reference"));
        assert!(shared(&a, &with(Some("7-2025"), 4)).contains(&"reference"));
        let (b, c) = (with(Some("7-2025"), 5), with(Some("7-2025"), 6));
        assert!(shared(&b, &c).contains(&"reference"));
        assert!(!shared(&b, &with(Some("8-2026"), 6)).contains(&"reference"));
        // Copies of the frames are the same frames, unless the reflectances differ.
        let copied = |reflectance: f64, frames: &[&str]| {
            let mut b = circumstances();
            let reference = b.white_reference.as_mut().unwrap();
            reference.calibration_ids = Vec::new();
            reference.reflectance = Some(reflectance);
            reference.frames_sha256 = frames.iter().map(|hash| (*hash).to_owned()).collect();
            b
        };
        let c = copied(0.99, &["a4"]);
        assert!(shared(&a, &c).contains(&"reference"));
        assert!(shared(&c, &c).contains(&"reference"));
        for other in [
            copied(0.98, &["a4"]),
            copied(0.99, &["a4", "a5"]),
            copied(0.99, &[]),
        ] {
            assert!(!shared(&c, &other).contains(&"reference"), "{other:?}");
        }
        let unknown = copied(0.99, &[]);
        assert!(!shared(&unknown, &unknown).contains(&"reference"));
        let mut none = circumstances();
        none.white_reference = None;
        assert!(!shared(&a, &none).contains(&"reference"));
    }

    #[test]
    fn lines_are_stated_by_their_keys() {
        let read = |text| SharedChoice::read(text);
        assert_eq!(
            read("model, reference"),
            Ok(SharedChoice::Stated(vec!["model", "reference"]))
        );
        assert_eq!(read("none"), Ok(SharedChoice::Stated(vec![])));
        assert!(
            read("refernce")
                .unwrap_err()
                .contains("did you mean `reference`?")
        );
        assert!(read("").unwrap_err().contains("expected none, or some of"));
        let a = circumstances();
        let lines = decided(&[&a, &a], &SharedChoice::Stated(vec!["wedge"]));
        let shared: Vec<&str> = lines.iter().filter(|l| l.shared).map(|l| l.line).collect();
        assert_eq!(shared, ["wedge"]);
    }

    #[test]
    fn the_zeros_of_the_stages_are_not_shared() {
        let a = circumstances();
        let lines = decided(&[&a, &a], &SharedChoice::Recorded);
        let angles = lines.iter().find(|line| line.line == "angles").unwrap();
        assert!(angles.holds_for("theta_r_deg") && !angles.holds_for("azimuth_offset_deg"));
    }
}
