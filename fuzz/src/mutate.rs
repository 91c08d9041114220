//! Inputs from inputs: the mutations that every fuzzer begins with, in a fixed order.

/// A small generator (xorshift64*): the same sequence wherever it runs.
#[derive(Debug, Clone)]
pub struct Mutator {
    state: u64,
}

/// Values that programs stumble over.
const INTERESTING: [u8; 12] = [0, 1, 2, 7, 8, 0x0a, 0x12, 0x7f, 0x80, 0xfe, 0xff, 0x20];
/// Longest input that is made.
const MAX_LEN: usize = 4096;

impl Mutator {
    /// A generator with a seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        // Zero would stay zero.
        Self { state: seed | 1 }
    }

    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.state ^= self.state >> 12;
        self.state ^= self.state << 25;
        self.state ^= self.state >> 27;
        self.state.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    /// A number below `bound`, which is not zero.
    pub fn below(&mut self, bound: usize) -> usize {
        ((u128::from(self.bits()) * bound as u128) >> 64) as usize
    }

    /// Puts an input into `input`: one of `corpus`, with up to eight changes.
    pub fn mutate(&mut self, corpus: &[Vec<u8>], input: &mut Vec<u8>) {
        input.clear();
        input.extend_from_slice(&corpus[self.below(corpus.len())]);
        for _ in 0..self.below(9) {
            self.change(corpus, input);
        }
        input.truncate(MAX_LEN);
    }

    fn change(&mut self, corpus: &[Vec<u8>], input: &mut Vec<u8>) {
        if input.is_empty() {
            input.push(self.bits() as u8);
            return;
        }
        let at = self.below(input.len());
        match self.below(8) {
            0 => input[at] ^= 1 << self.below(8),
            1 => input[at] = INTERESTING[self.below(INTERESTING.len())],
            2 => input[at] = self.bits() as u8,
            3 => input.insert(at, INTERESTING[self.below(INTERESTING.len())]),
            4 => {
                input.remove(at);
            }
            5 => input.truncate(at),
            6 => {
                let end = (at + 1 + self.below(16)).min(input.len());
                let piece = input[at..end].to_vec();
                input.splice(at..at, piece);
            }
            _ => {
                let other = &corpus[self.below(corpus.len())];
                let start = self.below(other.len().max(1)).min(other.len());
                let end = (start + self.below(64)).min(other.len());
                input.splice(at..at, other[start..end].iter().copied());
            }
        }
    }
}
