//! The stacked observation.

/// The last `depth` observations as one vector, oldest first; zeros before the first one.
///
/// This is the paper's `z[t-w+1 : t]`. Padding is with zeros, not with copies of the first
/// observation, as in the paper's public code.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameStack {
    width: usize,
    frames: Vec<f64>,
}

impl FrameStack {
    /// An all-zero stack of `depth` observations with `width` entries each.
    #[must_use]
    pub fn new(width: usize, depth: usize) -> Self {
        Self { width, frames: vec![0.0; width * depth] }
    }

    /// Forgets every observation.
    pub fn clear(&mut self) {
        self.frames.fill(0.0);
    }

    /// Drops the oldest observation and appends the `width` entries that `observation` yields.
    pub fn push(&mut self, observation: impl IntoIterator<Item = f64>) {
        self.frames.copy_within(self.width.., 0);
        let newest = self.frames.len() - self.width;
        for (slot, entry) in self.frames[newest..].iter_mut().zip(observation) {
            *slot = entry;
        }
    }

    /// Puts `frames`, as [`stacked`](Self::stacked) gave them, in place of what is there.
    ///
    /// # Panics
    /// If there are not as many.
    pub fn restore(&mut self, frames: &[f64]) {
        self.frames.copy_from_slice(frames);
    }

    /// `[depth * width]`, oldest first.
    #[must_use]
    pub fn stacked(&self) -> &[f64] {
        &self.frames
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// The definition itself: entry (k, i) after t pushes is observation t - depth + k, or zero.
        #[test]
        fn stack_is_the_last_observations_with_zeros_before_the_first(
            width in 1..6usize, depth in 1..6usize, steps in 1..12usize, restart in 0..12usize,
        ) {
            let observation = |t: usize, i: usize| (100 * t + i + 1) as f64;
            let mut stack = FrameStack::new(width, depth);
            for t in 0..restart {
                stack.push((0..width).map(|i| -observation(t, i)));
            }
            stack.clear();
            for t in 0..steps {
                stack.push((0..width).map(|i| observation(t, i)));
            }
            for k in 0..depth {
                for i in 0..width {
                    let expected = (steps + k).checked_sub(depth).map_or(0.0, |t| observation(t, i));
                    prop_assert_eq!(stack.stacked()[k * width + i], expected);
                }
            }
        }
    }
}
