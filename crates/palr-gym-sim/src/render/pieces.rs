//! Which parts of a scene are there, where a scene holds parts of several.

/// Pieces that a scene can have.
const COUNT: usize = 512;

/// A set of pieces: geoms show only if the number in their user data is in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Pieces {
    words: [u64; COUNT / 64],
}

impl Pieces {
    /// Adds a piece; one that no scene can have is left out.
    pub fn insert(&mut self, piece: usize) {
        if let Some(word) = self.words.get_mut(piece / 64) {
            *word |= 1 << (piece % 64);
        }
    }

    /// True if the piece is there.
    #[must_use]
    pub fn contains(&self, piece: usize) -> bool {
        self.words.get(piece / 64).is_some_and(|word| word >> (piece % 64) & 1 == 1)
    }
}
