//! Spreading 64 bits: what seeds, streams of random numbers and hashes of positions are made with.

/// The finaliser of SplitMix64 (Steele, Lea and Flood 2014): a bijection in which every bit of the result depends on every bit given.
pub fn mix(z: u64) -> u64 {
    let z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ z >> 31
}
