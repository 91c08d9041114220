//! Expected values are NumPy 2.4's own output; the expression stands beside each.

use super::*;

#[test]
fn bits_equal_numpys_for_small_large_and_extreme_seeds() {
    // default_rng(seed).integers(0, 2**64, size=3, dtype=uint64)
    let cases: [(u64, [u64; 3]); 5] = [
        (0, [0xa30f_ebcf_d9c2_825f, 0x4510_bdf8_82d9_d721, 0x0a7d_3da9_4ecd_e8b8]),
        (1, [0x8306_bdf3_7922_e4ff, 0xf351_96bb_c152_a866, 0x24e7_a4f6_08ec_18cd]),
        (12345, [0x3a32_b18d_b2ff_c19d, 0x5117_1315_c9e4_c4de, 0xcc20_2482_3444_efd9]),
        (1 << 32, [0xe3c5_ebe2_85ac_1625, 0x8ea0_9968_fe31_dbcc, 0xcd08_4ff8_4d8d_e9be]),
        (u64::MAX, [0xae16_3a7a_8c47_568f, 0xd866_59f5_f338_2359, 0x01e5_2b19_5bc2_d24a]),
    ];
    for (seed, expected) in cases {
        let mut generator = Generator::from_seed(seed);
        assert_eq!(expected.map(|_| generator.next_u64()), expected, "seed {seed}");
    }
}

#[test]
fn streams_equal_numpys_sequences_of_entropy() {
    // default_rng([seed, stream]).integers(0, 2**64, size=2, dtype=uint64)
    let mut small = Generator::from_seed_and_stream(7, 9);
    assert_eq!(
        [small.next_u64(), small.next_u64()],
        [0xc610_6880_e054_2c07, 0xf83b_cc58_599a_4dce]
    );
    let mut large = Generator::from_seed_and_stream(1 << 40, 1 << 33);
    assert_eq!(
        [large.next_u64(), large.next_u64()],
        [0x7d71_71be_7074_1a8f, 0x0d1b_73b7_f218_217b]
    );
}

#[test]
fn uniform_equals_numpys() {
    // default_rng(3).uniform(-0.005, 0.005, 4)
    let mut generator = Generator::from_seed(3);
    let expected: [u64; 4] = [
        0xbf70_f8c8_8c30_ae48,
        0xbf65_8f7b_d561_f0b3,
        0x3f68_ae2e_f80e_db7e,
        0x3f4a_ec40_4a12_9708,
    ];
    assert_eq!(expected.map(|_| generator.uniform(-0.005, 0.005).to_bits()), expected);
}

/// A million draws reach every layer and the tail (266 and 261 times).
#[test]
fn a_million_normals_equal_numpys() {
    // a = default_rng(seed).standard_normal(1_000_000), folded over its bits
    for (seed, expected) in [(0, 0x9a61_22e3_9e35_e3c2_u64), (11, 0x4760_4a0b_7be9_4672)] {
        let mut generator = Generator::from_seed(seed);
        let folded = (0..1_000_000).fold(0_u64, |folded, _| {
            folded.wrapping_mul(31).wrapping_add(generator.standard_normal().to_bits())
        });
        assert_eq!(folded, expected, "seed {seed}");
    }
}
