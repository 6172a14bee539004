//! How many refinement iterations a network does: a given number, or as many as its flow needs.

use std::fmt;
use std::num::NonZeroUsize;
use std::str::FromStr;

use burn::tensor::Tensor;

use crate::estimate::Request;
use crate::facts::Facts;
use crate::frames::Border;

/// One in this many coarse pixels may move by [`FAST`] times the limit of the mean or more when the flow counts as still.
const ONE_IN: usize = 100;
const FAST: f32 = 4.0;

/// Refinement iterations of a network as `--iters` gives them: `12`, `auto`, or `auto:0.02`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Iterations {
    /// Always this many.
    Exactly(NonZeroUsize),
    /// At most the network's default, and no more once the flow moves by less than this many pixels on average: [`Request::still_px`].
    UntilStill {
        /// Pixels of the frames that the network sees.
        still_px: f32,
    },
}

/// A text that gives no [`Iterations`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected a number of iterations from 1 to {}, or auto, or auto:PX with pixels greater than 0, such as auto:{}; found `{}`",
    Iterations::MOST, Iterations::STILL_PX, .0.escape_debug()
)]
pub struct IterationsError(String);

impl Iterations {
    /// The pixels of `auto`: those at which RAFT-S with its authors' weights stops after 7 to 9 of 32 iterations on faces, and on large
    /// motions not before the end.
    pub const STILL_PX: f32 = 0.07;
    /// The largest number that a text can give.
    pub const MOST: usize = 1000;
    /// The fewest after which the flow can be still.
    const FEWEST: usize = 2;

    /// The network's default number.
    pub fn default_of(facts: &Facts) -> Self {
        Self::Exactly(default_number(facts))
    }

    /// The most iterations that a network does: 1 if it does not refine its flow.
    pub fn most(self, facts: &Facts) -> NonZeroUsize {
        match self {
            Self::Exactly(number) if facts.refines() => number,
            _ => default_number(facts),
        }
    }

    /// [`Request::still_px`] for a network; `None` for a number, and for a network whose default is too few iterations to stop before.
    pub fn still_px(self, facts: &Facts) -> Option<f32> {
        match self {
            Self::UntilStill { still_px } if facts.iterations.default > Self::FEWEST => Some(still_px),
            _ => None,
        }
    }

    /// The same for frames that are scaled by `factor` before the network sees them: pixels stay those of the frames before.
    pub fn scaled(self, factor: f64) -> Self {
        match self {
            Self::Exactly(_) => self,
            Self::UntilStill { still_px } => {
                Self::UntilStill { still_px: (f64::from(still_px) * factor) as f32 }
            }
        }
    }
}

fn default_number(facts: &Facts) -> NonZeroUsize {
    NonZeroUsize::new(facts.iterations.default).unwrap_or(NonZeroUsize::MIN)
}

impl From<NonZeroUsize> for Iterations {
    fn from(number: NonZeroUsize) -> Self {
        Self::Exactly(number)
    }
}

impl FromStr for Iterations {
    type Err = IterationsError;

    fn from_str(text: &str) -> Result<Self, IterationsError> {
        let found = match text.strip_prefix("auto") {
            Some("") => Some(Self::UntilStill { still_px: Self::STILL_PX }),
            Some(rest) => {
                let pixels = rest.strip_prefix(':').and_then(|pixels| pixels.parse().ok());
                let allowed = pixels.filter(|pixels: &f32| pixels.is_finite() && *pixels > 0.0);
                allowed.map(|still_px| Self::UntilStill { still_px })
            }
            None => {
                let number = text.parse().ok().filter(|number: &NonZeroUsize| number.get() <= Self::MOST);
                number.map(Self::Exactly)
            }
        };
        found.ok_or_else(|| IterationsError(text.to_owned()))
    }
}

/// As [`FromStr`] reads it.
impl fmt::Display for Iterations {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exactly(number) => write!(f, "{number}"),
            Self::UntilStill { still_px } => write!(f, "auto:{still_px}"),
        }
    }
}

srflow_core::serialize_as_text!(Iterations);

/// The iterations of one level, counted while they are done.
pub(crate) struct Refinement {
    most: usize,
    done: usize,
    rule: Option<Rule>,
}

/// See [`Request::still_px`].
struct Rule {
    px: f32,
    border: Border,
    /// Whether the flow was still in the iteration before.
    still_before: bool,
}

impl Request {
    /// At most `most` iterations on frames with this border. Panics when they are none.
    pub(crate) fn refinement(&self, most: usize, border: Border) -> Refinement {
        assert!(most > 0, "at least one iteration");
        // Losses compare the flows of as many iterations for every sample.
        let px = self.still_px.filter(|_| !self.every_iteration);
        let rule = px.map(|px| Rule { px, border, still_before: false });
        Refinement { most, done: 0, rule }
    }
}

impl Refinement {
    /// Counts an iteration that changed the flow by `change`, `[batch, 2, rows, columns]` in coarse pixels, and returns whether it was
    /// the last.
    pub(crate) fn ends_with(&mut self, change: &Tensor<4>) -> bool {
        self.done += 1;
        if self.done == self.most {
            return true;
        }
        let Some(rule) = &mut self.rule else { return false };
        let still = is_still(change, rule.border, rule.px);
        let still_before = std::mem::replace(&mut rule.still_before, still);
        still && still_before
    }

    /// The number of iterations so far.
    pub(crate) fn done(&self) -> usize {
        self.done
    }
}

/// Whether in every pair the coarse pixels moved by less than `px` pixels on average, and at most 1 in [`ONE_IN`] by [`FAST`] times as
/// many. Those beyond the border do not count.
fn is_still(change: &Tensor<4>, border: Border, px: f32) -> bool {
    let [_, _, rows, columns] = change.dims();
    let stride = border.padded()[0] / rows;
    let [inside_rows, inside_columns] = border.coarse_inside(stride);
    let limit = px / stride as f32;
    // On the host: one pass over two channels, where tensor operations would need several and store what is between them.
    let data = change.clone().into_data().convert::<f32>();
    let numbers = data.as_slice::<f32>().expect("converted to f32");
    numbers.chunks_exact(2 * rows * columns).all(|pair| {
        let (u, v) = pair.split_at(rows * columns);
        let (mut sum, mut fast) = (0.0, 0);
        for row in inside_rows.clone() {
            let row = row * columns + inside_columns.start..row * columns + inside_columns.end;
            for (u, v) in u[row.clone()].iter().zip(&v[row]) {
                let length = (u * u + v * v).sqrt();
                sum += f64::from(length);
                fast += usize::from(length >= FAST * limit);
            }
        }
        let pixels = inside_rows.len() * inside_columns.len();
        // Not so for NaN.
        sum < f64::from(limit) * pixels as f64 && fast * ONE_IN <= pixels
    })
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};

    use super::*;
    use crate::Architecture;

    #[test]
    fn a_text_gives_a_number_or_a_rule() {
        let exactly = |number| Iterations::Exactly(NonZeroUsize::new(number).expect("some"));
        for (text, expected) in [
            ("1", exactly(1)),
            ("1000", exactly(1000)),
            ("auto", Iterations::UntilStill { still_px: 0.07 }),
            ("auto:0.02", Iterations::UntilStill { still_px: 0.02 }),
            ("auto:1e-3", Iterations::UntilStill { still_px: 0.001 }),
            ("auto:1000", Iterations::UntilStill { still_px: 1000.0 }),
        ] {
            let found: Iterations = text.parse().expect(text);
            assert_eq!(found, expected);
            assert_eq!(found.to_string().parse(), Ok(found), "what is shown can be read");
        }
        let wrong = [
            "",
            "0",
            "-1",
            "1001",
            "1.5",
            "x",
            "auto:",
            "auto:0",
            "auto:-1",
            "auto:nan",
            "auto:inf",
            "auto:1e99",
            "auto:1e-99",
            "auto:x",
            "auto:0.07px",
            "auto 1",
            "auto0.1",
            "automatic",
            "Auto",
            "auto:\u{1b}[2J",
        ];
        for text in wrong {
            let error = text.parse::<Iterations>().expect_err(text).to_string();
            assert!(error.contains("from 1 to 1000") && error.contains("auto:0.07"), "{error}");
            assert!(error.contains(&format!("found `{}`", text.escape_debug())), "{error}");
        }
    }

    /// One that does not refine does its one pass; one whose default is two iterations has none to save.
    #[test]
    fn every_network_takes_auto() {
        let auto = Iterations::UntilStill { still_px: 0.5 };
        let of = |iterations: Iterations, network: Architecture| {
            (iterations.most(network.facts()).get(), iterations.still_px(network.facts()))
        };
        assert_eq!(of(auto, Architecture::Raft), (32, Some(0.5)));
        assert_eq!(of(auto.scaled(0.5), Architecture::Raft), (32, Some(0.25)));
        assert_eq!(of(auto, Architecture::SrFlow), (2, None));
        assert_eq!(of(auto, Architecture::FlowNetS), (1, None));
        let five = Iterations::Exactly(NonZeroUsize::new(5).expect("some"));
        assert_eq!(of(five.scaled(0.5), Architecture::Raft), (5, None));
        assert_eq!(of(five, Architecture::FlowNetS), (1, None));
        assert_eq!(of(Iterations::default_of(Architecture::Raft.facts()), Architecture::Raft), (32, None));
    }

    /// Changes by the given pixels at some coarse pixels of 8x8, zero elsewhere.
    fn change([batch, rows, columns]: [usize; 3], moved: &[([usize; 3], f32)]) -> Tensor<4> {
        let mut numbers = vec![0.0; batch * 2 * rows * columns];
        for ([pair, row, column], px) in moved {
            // Downwards, so that both channels are read.
            numbers[((2 * pair + 1) * rows + row) * columns + column] = px / 8.0;
        }
        Tensor::from_data(TensorData::new(numbers, [batch, 2, rows, columns]), &Device::flex())
    }

    fn ends(request: &Request, border: Border, changes: &[&Tensor<4>]) -> Option<usize> {
        let mut refinement = request.refinement(request.iterations, border);
        let last = changes.iter().position(|change| refinement.ends_with(change))?;
        assert_eq!(refinement.done(), last + 1);
        Some(last + 1)
    }

    #[test]
    fn refinement_ends_after_two_iterations_in_a_row_in_which_nothing_moves() {
        let size = [2, 8, 9];
        let border = Border::new([64, 72], 8);
        let auto = Request { still_px: Some(0.5), ..Request::new(6) };
        let still = change(size, &[([0, 1, 1], 1.99), ([1, 7, 8], -1.99)]);
        let moving = change(size, &[([1, 7, 8], -2.0)]);
        let everywhere = |px: f32| still.clone() * 0.0 + px / 8.0 / 2.0_f32.sqrt();
        assert_eq!(ends(&auto, border, &[&everywhere(0.49); 6]), Some(2));
        assert_eq!(ends(&auto, border, &[&everywhere(0.51); 6]), Some(6));
        assert_eq!(ends(&auto, border, &[&still; 6]), Some(2));
        assert_eq!(ends(&auto, border, &[&moving; 6]), Some(6));
        assert_eq!(ends(&auto, border, &[&still, &moving, &still, &still, &moving]), Some(4));
        assert_eq!(ends(&auto, border, &[&moving, &still, &moving]), None);
        let lost = change(size, &[([0, 0, 0], f32::NAN)]);
        assert_eq!(ends(&auto, border, &[&lost; 6]), Some(6), "NaN is not still");
        assert_eq!(ends(&Request { iterations: 1, ..auto.clone() }, border, &[&still]), Some(1));
        assert_eq!(ends(&Request::new(6), border, &[&still; 6]), Some(6), "without the rule");
        let training = Request { every_iteration: true, ..auto };
        assert_eq!(ends(&training, border, &[&still; 6]), Some(6), "in training");
    }

    #[test]
    fn one_pixel_in_a_hundred_may_move_fast_and_padding_may_too() {
        let auto = Request { still_px: Some(0.5), ..Request::new(6) };
        // 299 and 300 coarse pixels.
        for (rows, columns, expected) in [(13, 23, 6), (12, 25, 2)] {
            let three = [2, 3, 11].map(|row| ([0, row, 4], 9.0));
            let border = Border::new([8 * rows, 8 * columns], 8);
            assert_eq!(ends(&auto, border, &[&change([1, rows, columns], &three); 6]), Some(expected));
        }
        // 33 pixels, 15 of 31 more before them: coarse pixel 0 is beyond the border, and 6 and 7.
        let border = Border::new([33, 33], 64);
        let moving = |at: usize| change([1, 8, 8], &[([0, at, 3], 9.0)]);
        let found = [0, 1, 5, 6, 7].map(|row| ends(&auto, border, &[&moving(row); 6]));
        assert_eq!(found, [Some(2), Some(6), Some(6), Some(2), Some(2)]);
    }
}
