//! Counter-based random numbers: every photon has its own stream, identified by numbers.
//!
//! A [`RandomStream`] is SplitMix64 (Steele, Lea, Flood 2014) on a key mixed from the run's seed, a
//! purpose and an index; its n-th number is a function of the key and n only. A result therefore
//! depends on the seed, and never on threads, shards or the order in which photons are traced.

use rand::TryRng;

/// Use of a stream; streams of different purposes are independent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// The path of one photon.
    Photon,
    /// Values shared by the photons of one batch.
    Batch,
    /// The shape of a surface.
    Surface,
    /// The path of one photon of a preview, which is not part of the run.
    Preview,
}

/// A reproducible stream of random numbers.
#[derive(Debug, Clone)]
pub struct RandomStream {
    state: u64,
}

const GAMMA: u64 = 0x9e37_79b9_7f4a_7c15;

#[inline]
fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl RandomStream {
    /// Makes stream number `index` of a purpose.
    #[inline]
    #[must_use]
    pub fn new(seed: u64, purpose: Purpose, index: u64) -> Self {
        let key = mix(seed.wrapping_add(GAMMA)) ^ mix(purpose as u64 + 0x5151);
        RandomStream {
            state: mix(key.wrapping_add(mix(index.wrapping_add(0xa076_1d64_78bd_642f)))),
        }
    }

    /// 64 random bits.
    #[inline]
    pub fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(GAMMA);
        mix(self.state)
    }

    /// A uniform number in [0, 1) of 53 bits.
    #[inline]
    pub fn uniform(&mut self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "53 bits fit an f64 exactly")]
        let bits = (self.bits() >> 11) as f64;
        bits * (1.0 / 9_007_199_254_740_992.0)
    }

    /// A uniform index below `n` > 0.
    #[inline]
    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.bits()) * n as u128) >> 64) as usize
    }
}

impl TryRng for RandomStream {
    type Error = std::convert::Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Self::Error> {
        Ok((self.bits() >> 32) as u32)
    }

    fn try_next_u64(&mut self) -> Result<u64, Self::Error> {
        Ok(self.bits())
    }

    fn try_fill_bytes(&mut self, to: &mut [u8]) -> Result<(), Self::Error> {
        for bytes in to.chunks_mut(8) {
            let bits = self.bits().to_le_bytes();
            bytes.copy_from_slice(&bits[..bytes.len()]);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbouring_streams_are_uniform_and_independent() {
        let n = 20_000;
        let (mut sum, mut square, mut product) = (0.0, 0.0, 0.0);
        for index in 0..n {
            let a = RandomStream::new(7, Purpose::Photon, index).uniform() - 0.5;
            let b = RandomStream::new(7, Purpose::Photon, index + 1).uniform() - 0.5;
            sum += a;
            square += a * a;
            product += a * b;
        }
        #[expect(clippy::cast_precision_loss, reason = "a small count")]
        let n = n as f64;
        // Five standard errors: of the mean 1/√12n, of the square 1/√180n, of the product 1/12√n.
        assert!((sum / n).abs() < 5.0 / (12.0 * n).sqrt());
        assert!((square / n - 1.0 / 12.0).abs() < 5.0 / (180.0 * n).sqrt());
        assert!((product / n).abs() < 5.0 / (12.0 * n.sqrt()));
    }

    #[test]
    fn a_stream_depends_only_on_its_key() {
        let draw = |seed, index| RandomStream::new(seed, Purpose::Photon, index).bits();
        assert_eq!(draw(1, 2), draw(1, 2));
        assert_ne!(draw(1, 2), draw(2, 1));
        assert_ne!(
            RandomStream::new(1, Purpose::Surface, 2).bits(),
            RandomStream::new(1, Purpose::Batch, 2).bits()
        );
    }
}
