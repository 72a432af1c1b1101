//! The lines of a budget.

/// Standard uncertainties by source, in the unit of the parameter. They combine in quadrature.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Budget {
    /// Counting noise of samples and flats.
    pub counting: f64,
    /// Certificate of the white reference.
    pub reference: f64,
    /// Zero, scale and eccentricity of the stages, and angle between lamp and camera.
    pub angles: f64,
    /// Refractive index.
    pub material: f64,
    /// Tilt of the sample on the turntable.
    #[serde(default)]
    pub wedge: f64,
    /// Lamp drift.
    pub drift: f64,
    /// Non-linearity and exposure times of the camera.
    #[serde(default)]
    pub detector: f64,
    /// Prior on the stray light.
    pub background: f64,
    /// Model error.
    pub model: f64,
    /// Departure from the linear approximation: half of the excess of the profile interval over the linear one, and
    /// half the distance to another minimum that the data do not exclude.
    #[serde(default)]
    pub shape: f64,
    /// Priors stated by the user.
    #[serde(default)]
    pub prior: f64,
    /// Standard errors of traced radiances; 0 without the ray tracer.
    #[serde(default)]
    pub tracer: f64,
}

/// A line with its name in the JSON form.
type NamedLine = (&'static str, fn(&mut Budget) -> &mut f64);

/// The lines in the order of the documentation.
const LINES: [NamedLine; 12] = [
    ("counting", |b| &mut b.counting),
    ("reference", |b| &mut b.reference),
    ("angles", |b| &mut b.angles),
    ("material", |b| &mut b.material),
    ("wedge", |b| &mut b.wedge),
    ("drift", |b| &mut b.drift),
    ("detector", |b| &mut b.detector),
    ("background", |b| &mut b.background),
    ("model", |b| &mut b.model),
    ("shape", |b| &mut b.shape),
    ("prior", |b| &mut b.prior),
    ("tracer", |b| &mut b.tracer),
];

impl Budget {
    /// Combined variance.
    #[must_use]
    pub fn variance(&self) -> f64 {
        self.named().iter().map(|(_, part)| part * part).sum()
    }

    /// Combined standard uncertainty.
    #[must_use]
    pub fn combined(&self) -> f64 {
        self.variance().sqrt()
    }

    /// Converts the budget to another unit.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Budget {
        self.with_each(|part| part * factor.abs())
    }

    /// Changes every line.
    pub(super) fn with_each(mut self, change: impl Fn(f64) -> f64) -> Budget {
        for (_, line) in LINES {
            let part = line(&mut self);
            *part = change(*part);
        }
        self
    }

    /// Returns the lines with their names, in the order of the documentation.
    #[must_use]
    pub fn named(&self) -> [(&'static str, f64); 12] {
        let mut all = *self;
        LINES.map(|(name, line)| (name, *line(&mut all)))
    }
}
