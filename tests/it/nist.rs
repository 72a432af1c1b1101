//! NIST's certified nonlinear regressions: 27 problems, two starts each, against the solver.
//!
//! Every run must give at least 10 correct digits of the worst parameter, and 52 of the 54 at least
//! 10 digits of the worst standard deviation (Lanczos1's residuals are rounding noise). A run that
//! claims success must be right.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use nalgebra::{Dyn, U1};
use num_dual::{Derivative, DualDVec64, DualNum};
use ridged::fit::least_squares::LeastSquares;
use ridged::fit::least_squares::levenberg_marquardt::{Bounds, Settings, minimise};
use ridged::fit::uncertainty::covariance::covariance;

/// An expression of the problem files: `+ - * / **`, parentheses, exp, cos, sin, atan, pi, names.
enum Expression {
    Number(f64),
    Parameter(usize),
    Predictor(usize),
    Call(String, Box<Expression>),
    Negated(Box<Expression>),
    Binary(char, Box<Expression>, Box<Expression>),
}

impl Expression {
    /// Returns the value at `x`, with its derivatives with respect to all parameters `b`.
    fn evaluate(&self, b: &[DualDVec64], x: &[f64]) -> DualDVec64 {
        match self {
            Expression::Number(v) => DualDVec64::from_re(*v),
            Expression::Predictor(k) => DualDVec64::from_re(x[*k]),
            Expression::Parameter(k) => b[*k].clone(),
            Expression::Negated(e) => -e.evaluate(b, x),
            Expression::Call(name, e) => {
                let e = e.evaluate(b, x);
                match name.as_str() {
                    "exp" => e.exp(),
                    "cos" => e.cos(),
                    "sin" => e.sin(),
                    "atan" => e.atan(),
                    other => panic!("unknown function {other}"),
                }
            }
            Expression::Binary(sign, left, right) => {
                let (l, r) = (left.evaluate(b, x), right.evaluate(b, x));
                match sign {
                    '+' => l + r,
                    '-' => l - r,
                    '*' => l * r,
                    '/' => l / r,
                    // The general power has no real logarithm of a negative base.
                    '^' if r.eps == Derivative::none() => l.powf(r.re),
                    '^' => l.powd(r),
                    other => panic!("unknown operator {other}"),
                }
            }
        }
    }
}

struct Parser<'a> {
    text: Vec<char>,
    at: usize,
    parameters: &'a [String],
    predictors: &'a [String],
}

impl Parser<'_> {
    fn peek(&mut self) -> Option<char> {
        while self.text.get(self.at) == Some(&' ') {
            self.at += 1;
        }
        self.text.get(self.at).copied()
    }

    fn takes(&mut self, token: &str) -> bool {
        self.peek();
        let here: String = self.text[self.at..].iter().take(token.len()).collect();
        let power = token == "*" && self.text.get(self.at + 1) == Some(&'*');
        if here == token && !power {
            self.at += token.len();
            return true;
        }
        false
    }

    fn sum(&mut self) -> Expression {
        let mut left = self.product();
        loop {
            let sign = match () {
                () if self.takes("+") => '+',
                () if self.takes("-") => '-',
                () => return left,
            };
            left = Expression::Binary(sign, Box::new(left), Box::new(self.product()));
        }
    }

    fn product(&mut self) -> Expression {
        let mut left = self.signed();
        loop {
            let sign = match () {
                () if self.takes("*") => '*',
                () if self.takes("/") => '/',
                () => return left,
            };
            left = Expression::Binary(sign, Box::new(left), Box::new(self.signed()));
        }
    }

    /// A power binds tighter than the minus before it.
    fn signed(&mut self) -> Expression {
        if self.takes("-") {
            return Expression::Negated(Box::new(self.signed()));
        }
        let base = self.atom();
        if self.takes("**") {
            return Expression::Binary('^', Box::new(base), Box::new(self.signed()));
        }
        base
    }

    fn atom(&mut self) -> Expression {
        if self.takes("(") {
            let inside = self.sum();
            assert!(self.takes(")"), "unbalanced parenthesis");
            return inside;
        }
        self.peek();
        let word: String = self.text[self.at..]
            .iter()
            .take_while(|c| c.is_alphanumeric() || **c == '.')
            .collect();
        self.at += word.len();
        if let Some(k) = self.parameters.iter().position(|p| *p == word) {
            return Expression::Parameter(k);
        }
        if let Some(k) = self.predictors.iter().position(|p| *p == word) {
            return Expression::Predictor(k);
        }
        if word == "pi" {
            return Expression::Number(std::f64::consts::PI);
        }
        if let Ok(v) = word.parse() {
            return Expression::Number(v);
        }
        assert!(self.takes("("), "unknown word `{word}`");
        let inside = self.sum();
        assert!(self.takes(")"), "unbalanced parenthesis");
        Expression::Call(word, Box::new(inside))
    }
}

struct Problem {
    name: String,
    model: Expression,
    starts: [Vec<f64>; 2],
    values: Vec<f64>,
    deviations: Vec<f64>,
    predictors: Vec<Vec<f64>>,
    responses: Vec<f64>,
}

impl Problem {
    fn read(path: &Path) -> Problem {
        let text = std::fs::read_to_string(path).expect("the problem files are in tests/data");
        let table: toml::Table = text.parse().expect("a problem file is TOML");
        let number = |v: &toml::Value| v.as_float().expect("a number");
        let parameters = table["parameter"].as_array().expect("parameters");
        let column = |key: &str| {
            parameters
                .iter()
                .map(|p| number(&p[key]))
                .collect::<Vec<_>>()
        };
        let names: Vec<String> = parameters
            .iter()
            .map(|p| p["name"].as_str().expect("a name").to_owned())
            .collect();
        let columns = table["data"]["columns"].as_array().expect("columns");
        let predictors: Vec<String> = columns[1..]
            .iter()
            .map(|c| c.as_str().expect("a name").to_owned())
            .collect();
        let rows: Vec<Vec<f64>> = table["data"]["rows"]
            .as_array()
            .expect("rows")
            .iter()
            .map(|r| r.as_array().expect("a row").iter().map(number).collect())
            .collect();
        let logarithmic = table["response"].as_str() == Some("ln(y)");
        let model = table["model"].as_str().expect("a model");
        let mut parser = Parser {
            text: model.chars().collect(),
            at: 0,
            parameters: &names,
            predictors: &predictors,
        };
        let expression = parser.sum();
        assert!(parser.peek().is_none(), "trailing text in `{model}`");
        Problem {
            name: table["name"].as_str().expect("a name").to_owned(),
            model: expression,
            starts: [column("start1"), column("start2")],
            values: column("value"),
            deviations: column("sd"),
            predictors: rows.iter().map(|r| r[1..].to_vec()).collect(),
            responses: rows
                .iter()
                .map(|r| if logarithmic { r[0].ln() } else { r[0] })
                .collect(),
        }
    }
}

impl LeastSquares for &Problem {
    fn n_parameters(&self) -> usize {
        self.values.len()
    }

    fn n_residuals(&self) -> usize {
        self.responses.len()
    }

    fn evaluate(&self, b: &[f64], residuals: &mut [f64], jacobian: &mut [f64]) {
        let (m, n) = (self.responses.len(), b.len());
        let b = b.iter().enumerate();
        let b: Vec<_> = b
            .map(|(k, b)| DualDVec64::from_re(*b).derivative(n, k))
            .collect();
        for (i, x) in self.predictors.iter().enumerate() {
            let model = self.model.evaluate(&b, x);
            residuals[i] = model.re - self.responses[i];
            for (j, s) in model.eps.unwrap_generic(Dyn(n), U1).iter().enumerate() {
                jacobian[i + j * m] = *s;
            }
        }
    }
}

/// Digits of the worst entry, capped at the certificates' 11.
fn log_relative_error(found: &[f64], certified: &[f64]) -> f64 {
    let digits = |(q, c): (&f64, &f64)| {
        if !q.is_finite() {
            return 0.0;
        }
        (-((q - c).abs() / c.abs()).log10()).clamp(0.0, 11.0)
    };
    found.iter().zip(certified).map(digits).fold(11.0, f64::min)
}

fn problems() -> Vec<Problem> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/nist-strd");
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .expect("the problem files are in tests/data")
        .map(|entry| entry.expect("a readable folder").path())
        .filter(|path| path.extension().is_some_and(|e| e == "toml"))
        .collect();
    files.sort();
    files.iter().map(|path| Problem::read(path)).collect()
}

#[test]
fn the_certified_values_come_out_to_ten_digits_from_both_starts() {
    let (mut parameters, mut deviations, mut table) = (0, 0, String::new());
    let problems = problems();
    assert_eq!(problems.len(), 27);
    for problem in &problems {
        for (k, start) in problem.starts.iter().enumerate() {
            let m = minimise(
                problem,
                start,
                &Bounds::none(start.len()),
                &Settings::default(),
                &AtomicBool::new(false),
            );
            let lre = log_relative_error(&m.parameters, &problem.values);
            let cov = covariance(&m.jacobian, m.residuals.len(), &m.residuals);
            let birge = cov.chi2_reduced.sqrt();
            let std = cov.standard_deviations().into_iter().map(|s| birge * s);
            let lre_sd = log_relative_error(&std.collect::<Vec<_>>(), &problem.deviations);
            parameters += usize::from(lre >= 10.0);
            deviations += usize::from(lre_sd >= 10.0);
            table += &format!(
                "{:10} start {} parameters {lre:5.2} sd {lre_sd:5.2} {:?} after {}\n",
                problem.name,
                k + 1,
                m.ending,
                m.evaluations
            );
            assert!(
                lre >= 4.0 || !m.ending.is_success(),
                "{} start {} claims success on a wrong answer",
                problem.name,
                k + 1
            );
        }
    }
    println!("{table}");
    assert_eq!(parameters, 54, "\n{table}");
    assert!(deviations >= 52, "\n{table}");
}
