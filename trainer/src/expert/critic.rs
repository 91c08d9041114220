//! What the critics learn from: targets, and the gradients of their losses.

use pulp::{Arch, Simd};
use serde::{Deserialize, Serialize};

use crate::learning::network::LayerShape;

/// How the critics estimate returns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CriticKind {
    /// Plain soft actor-critic: each critic estimates the mean; the lower of the two counts.
    Sac,
    /// Truncated quantile critics: each estimates quantiles; of all quantiles of the target the
    /// highest are dropped.
    Tqc,
}

impl CriticKind {
    /// `sac` or `tqc`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Sac => "sac",
            Self::Tqc => "tqc",
        }
    }
}

/// A critic's layers: observation and action in, `outputs` numbers out.
#[must_use]
pub fn layers(input_size: usize, hidden: usize, outputs: usize) -> Vec<LayerShape> {
    vec![
        LayerShape::new("hidden_1", input_size, hidden),
        LayerShape::new("hidden_2", hidden, hidden),
        LayerShape::new("values", hidden, outputs),
    ]
}

/// What a transition is worth beside what its last observation is.
#[derive(Debug, Clone, Copy)]
pub struct Returns<'a> {
    /// `[n]`.
    pub rewards: &'a [f32],
    /// The most that a reward counts for.
    pub reward_cap: f32,
    /// `[n]`: 0 where the task ended the episode, else 1.
    pub continues: &'a [f32],
    /// γ.
    pub discount: f32,
    /// `[n]`: α log π of the next action.
    pub next_cost: &'a [f32],
}

/// Targets of each row: what `outputs` of the two target critics, `[n, outputs]` each, leave when
/// the highest `dropped` of all are dropped; ascending. `[n, 2 outputs - dropped]`. With one output
/// and one dropped, this is the lower of two values.
///
/// # Source
/// Kuznetsov et al. (2020), equations (9) to (11).
pub fn targets(
    next_values: [&[f32]; 2],
    outputs: usize,
    dropped: usize,
    returns: Returns<'_>,
    targets: &mut Vec<f32>,
) {
    targets.clear();
    let mut all = Vec::with_capacity(2 * outputs);
    let rows = next_values[0].chunks_exact(outputs).zip(next_values[1].chunks_exact(outputs));
    for (row, (first, second)) in rows.enumerate() {
        all.clear();
        all.extend_from_slice(first);
        all.extend_from_slice(second);
        all.sort_unstable_by(f32::total_cmp);
        let factor = returns.discount * returns.continues[row];
        let reward = returns.rewards[row].min(returns.reward_cap);
        let constant = reward - factor * returns.next_cost[row];
        targets.extend(all[..2 * outputs - dropped].iter().map(|value| constant + factor * value));
    }
}

/// Loss of a critic's mean values `[n]`: half the mean squared error; and its gradient.
pub fn squared_loss(values: &[f32], targets: &[f32], gradient: &mut Vec<f32>) -> f64 {
    let n = values.len() as f32;
    gradient.clear();
    gradient.extend(values.iter().zip(targets).map(|(value, target)| (value - target) / n));
    let errors = values.iter().zip(targets).map(|(value, target)| f64::from(value - target));
    0.5 * errors.map(|error| error * error).sum::<f64>() / f64::from(n)
}

/// Loss of a critic's quantiles `[n, quantiles]` against `[n, targets]`: the mean over rows,
/// quantiles and targets of |τ - 1(error < 0)| · Huber(error), τ the middles of equal parts of
/// [0, 1]; and its gradient.
///
/// # Source
/// Kuznetsov et al. (2020), equation (12), after Dabney et al. (2018).
pub fn quantile_loss(
    quantiles: usize,
    values: &[f32],
    targets: &[f32],
    gradient: &mut Vec<f32>,
) -> f64 {
    let n = values.len() / quantiles;
    let targets_per_row = targets.len() / n;
    let share = 1.0 / (values.len() * targets_per_row) as f32;
    gradient.resize(values.len(), 0.0);
    let levels: Vec<f32> = (0..quantiles).map(|at| (at as f32 + 0.5) / quantiles as f32).collect();
    // Of a row, so that the inner loop runs along arrays.
    let mut losses = vec![0.0_f32; quantiles];
    let mut total = 0.0;
    let rows = values.chunks_exact(quantiles).zip(gradient.chunks_exact_mut(quantiles));
    for ((values, gradient), targets) in rows.zip(targets.chunks_exact(targets_per_row)) {
        quantile_slopes(values, &levels, targets, gradient, &mut losses);
        for slope in gradient.iter_mut() {
            *slope *= share;
        }
        total += losses.iter().map(|&loss| f64::from(loss)).sum::<f64>();
    }
    total * f64::from(share)
}

/// Of a row: the sums over its `targets` of each quantile's loss and of its slope.
#[pulp::with_simd(quantile_slopes = Arch::new())]
#[inline(always)]
fn quantile_slopes_with_simd<'a, S: Simd>(
    _simd: S,
    values: &'a [f32],
    levels: &'a [f32],
    targets: &'a [f32],
    slopes: &'a mut [f32],
    losses: &'a mut [f32],
) {
    slopes.fill(0.0);
    losses.fill(0.0);
    for &target in targets {
        let outputs = values.iter().zip(levels);
        for ((value, level), (slope, loss)) in outputs.zip(slopes.iter_mut().zip(losses.iter_mut()))
        {
            let error = target - value;
            let weight = if error < 0.0 { 1.0 - level } else { *level };
            let bounded = error.clamp(-1.0, 1.0);
            *slope -= weight * bounded;
            *loss += weight * bounded * (error - 0.5 * bounded);
        }
    }
}

/// The mean of a critic's values of each row and critic, as the actor sees it, and its gradients by
/// the two critics' outputs, so that Σ over both is that of mean(value).
pub fn actor_value(
    kind: CriticKind,
    values: [&[f32]; 2],
    outputs: usize,
    gradients: [&mut Vec<f32>; 2],
) -> f64 {
    let n = values[0].len() / outputs;
    let total = |values: &[f32]| values.iter().map(|&value| f64::from(value)).sum::<f64>();
    match kind {
        CriticKind::Tqc => {
            let share = 1.0 / (2 * n * outputs) as f32;
            for gradient in gradients {
                gradient.clear();
                gradient.resize(n * outputs, share);
            }
            (total(values[0]) + total(values[1])) * f64::from(share)
        }
        CriticKind::Sac => {
            let share = 1.0 / n as f32;
            let mut sum = 0.0;
            let [first_gradient, second_gradient] = gradients;
            first_gradient.clear();
            second_gradient.clear();
            for (first, second) in values[0].iter().zip(values[1]) {
                let is_first = first <= second;
                first_gradient.push(if is_first { share } else { 0.0 });
                second_gradient.push(if is_first { 0.0 } else { share });
                sum += f64::from(first.min(*second));
            }
            sum / n as f64
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lower_of_two_values_is_one_output_with_one_dropped() {
        let returns = Returns {
            rewards: &[1.0, 2.0, 7.0],
            reward_cap: 3.0,
            continues: &[1.0, 1.0, 0.0],
            discount: 0.5,
            next_cost: &[0.0, 4.0, 9.0],
        };
        let mut got = Vec::new();
        targets([&[4.0, 2.0, 8.0], &[6.0, -2.0, 9.0]], 1, 1, returns, &mut got);
        assert_eq!(got, [3.0, -1.0, 3.0]);
    }

    #[test]
    fn the_highest_quantiles_of_both_critics_are_dropped() {
        let returns = Returns {
            rewards: &[0.0],
            reward_cap: f32::INFINITY,
            continues: &[1.0],
            discount: 1.0,
            next_cost: &[0.0],
        };
        let mut got = Vec::new();
        targets([&[3.0, 1.0, 9.0], &[8.0, 2.0, 4.0]], 3, 2, returns, &mut got);
        assert_eq!(got, [1.0, 2.0, 3.0, 4.0]);
    }

    #[test]
    fn quantile_regression_finds_where_its_slopes_balance() {
        // 0, 0.1, .. 10 as targets, all but U(0, 10). Where v is at least 1 from its ends, the Huber
        // loss's slopes balance at τ (9.5 - v) = (1 - τ) (v - 0.5), so at v = 0.5 + 9 τ.
        let targets: Vec<f32> = (0..=100).map(|at| at as f32 / 10.0).collect();
        let mut values = vec![0.0; 5];
        let mut gradient = Vec::new();
        let mut last = f64::INFINITY;
        for _ in 0..4000 {
            last = quantile_loss(5, &values, &targets, &mut gradient);
            for (value, slope) in values.iter_mut().zip(&gradient) {
                *value -= 2.0 * slope;
            }
        }
        for (value, want) in values.iter().zip([1.4, 3.2, 5.0, 6.8, 8.6]) {
            assert!((value - want).abs() < 0.06, "{values:?}");
        }
        assert!(last > 0.0);
    }

    #[test]
    fn losses_have_the_gradients_of_finite_differences() {
        let values = [0.3_f32, -1.2, 2.0, 0.1, 0.9, -0.4];
        let targets = [0.2_f32, 1.9, -0.7, 0.05, 3.0, -2.0, 0.8, 1.1];
        let mut gradient = Vec::new();
        let mut scratch = Vec::new();
        quantile_loss(3, &values, &targets, &mut gradient);
        for at in 0..values.len() {
            let mut loss = |by: f32| {
                let mut shifted = values;
                shifted[at] += by;
                quantile_loss(3, &shifted, &targets, &mut scratch)
            };
            let want = (loss(1e-3) - loss(-1e-3)) / 2e-3;
            assert!((f64::from(gradient[at]) - want).abs() < 1e-4, "{at}");
        }
        squared_loss(&values, &targets[..6], &mut gradient);
        for at in 0..values.len() {
            let mut loss = |by: f32| {
                let mut shifted = values;
                shifted[at] += by;
                squared_loss(&shifted, &targets[..6], &mut scratch)
            };
            let want = (loss(1e-3) - loss(-1e-3)) / 2e-3;
            assert!((f64::from(gradient[at]) - want).abs() < 1e-4, "{at}");
        }
    }
}
