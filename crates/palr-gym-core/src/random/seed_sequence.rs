//! NumPy's `SeedSequence`: entropy of any length, hashed into a pool of four words.

const POOL_SIZE: usize = 4;
const XSHIFT: u32 = 16;

/// The 32-bit words of a seed, least significant first, without leading zeros (zero is one word).
pub(super) fn words(seed: u64) -> Vec<u32> {
    let (low, high) = (seed as u32, (seed >> 32) as u32);
    if high == 0 { vec![low] } else { vec![low, high] }
}

/// A multiplicative hash whose constant moves on with every use.
struct Hash {
    constant: u32,
    multiplier: u32,
}

impl Hash {
    fn apply(&mut self, value: u32) -> u32 {
        let value = value ^ self.constant;
        self.constant = self.constant.wrapping_mul(self.multiplier);
        let value = value.wrapping_mul(self.constant);
        value ^ (value >> XSHIFT)
    }
}

fn mix(left: u32, right: u32) -> u32 {
    let result = left.wrapping_mul(0xca01_f9dd).wrapping_sub(right.wrapping_mul(0x4973_f715));
    result ^ (result >> XSHIFT)
}

fn pool(entropy: &[u32]) -> [u32; POOL_SIZE] {
    let mut hash = Hash { constant: 0x43b0_d7e5, multiplier: 0x931e_8875 };
    let mut pool = [0; POOL_SIZE];
    for (i, slot) in pool.iter_mut().enumerate() {
        *slot = hash.apply(entropy.get(i).copied().unwrap_or(0));
    }
    for source in 0..POOL_SIZE {
        for target in 0..POOL_SIZE {
            if source != target {
                pool[target] = mix(pool[target], hash.apply(pool[source]));
            }
        }
    }
    for &word in entropy.iter().skip(POOL_SIZE) {
        for slot in &mut pool {
            *slot = mix(*slot, hash.apply(word));
        }
    }
    pool
}

/// `SeedSequence(entropy).generate_state(4, numpy.uint64)`.
pub(super) fn generate_state(entropy: &[u32]) -> [u64; 4] {
    let pool = pool(entropy);
    let mut hash = Hash { constant: 0x8b51_f9dd, multiplier: 0x58f3_8ded };
    let mut words = pool.iter().cycle().map(|&word| u64::from(hash.apply(word)));
    let mut next = || words.next().unwrap_or_default();
    std::array::from_fn(|_| next() | (next() << 32))
}
