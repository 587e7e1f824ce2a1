//! Frames of the base's byte stream: two header bytes, the length of the payload, the payload, and the exclusive or of
//! length and payload.

const HEADER: [u8; 2] = [0xAA, 0x55];
/// Length of the shortest payload: one part with one byte of data.
const SHORTEST: usize = 3;
/// Bytes of a frame beside its payload.
const AROUND: usize = 4;

/// Finds frames in a byte stream.
///
/// Torn or corrupt bytes cost the frames that they are in. After a wrong checksum, the search goes on behind the header
/// that was wrong. At most one frame is kept, which has at most 259 bytes.
#[derive(Debug, Clone, Default)]
pub struct Frames {
    buffer: Vec<u8>,
    rejected: u64,
}

impl Frames {
    /// Takes bytes, and passes the payload of each complete frame to `each`.
    pub fn feed(&mut self, bytes: &[u8], mut each: impl FnMut(&[u8])) {
        for &byte in bytes {
            self.buffer.push(byte);
            self.search(&mut each);
        }
    }

    /// Returns the number of frames so far whose length, parts or checksum were wrong.
    pub fn rejected(&self) -> u64 {
        self.rejected
    }

    /// Forgets an incomplete frame.
    pub fn clear(&mut self) {
        self.buffer.clear();
    }

    fn search(&mut self, each: &mut impl FnMut(&[u8])) {
        loop {
            let is_begin = |tail: &[u8]| tail.iter().zip(HEADER).all(|(byte, expected)| *byte == expected);
            let begin = (0..self.buffer.len()).find(|at| is_begin(&self.buffer[*at..]));
            self.buffer.drain(..begin.unwrap_or(self.buffer.len()));
            let Some(&length) = self.buffer.get(HEADER.len()) else { return };
            let length = usize::from(length);
            if length >= SHORTEST {
                let Some(frame) = self.buffer.get(..length + AROUND) else { return };
                let payload = &frame[HEADER.len() + 1..length + AROUND - 1];
                if checksum(&frame[HEADER.len()..]) == 0 && parts(payload).all(|part| part.is_some()) {
                    each(payload);
                    self.buffer.drain(..length + AROUND);
                    continue;
                }
            }
            self.rejected += 1;
            self.buffer.drain(..1);
        }
    }
}

/// Returns a frame with this payload.
///
/// # Panics
/// With a payload of more than 255 bytes.
pub(crate) fn frame(payload: &[u8]) -> Vec<u8> {
    let length = u8::try_from(payload.len()).expect("commands are short");
    let mut frame = [&HEADER, &[length][..], payload].concat();
    frame.push(checksum(&frame[HEADER.len()..]));
    frame
}

fn checksum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| sum ^ byte)
}

/// Returns the parts of a payload, each an identifier with its data. `None` is a part that is cut off, and the last.
pub(crate) fn parts(payload: &[u8]) -> impl Iterator<Item = Option<(u8, &[u8])>> {
    let mut rest = payload;
    std::iter::from_fn(move || {
        let (&id, tail) = rest.split_first()?;
        let part = tail.split_first().and_then(|(&length, tail)| tail.split_at_checked(length.into()));
        rest = part.map_or(&[], |(_, behind)| behind);
        Some(part.map(|(data, _)| (id, data)))
    })
}

#[cfg(test)]
mod tests {
    use proptest::{collection::vec, prelude::*, sample::Index};

    use super::*;

    fn payloads(bytes: &[u8]) -> Vec<Vec<u8>> {
        let (mut frames, mut found) = (Frames::default(), Vec::new());
        frames.feed(bytes, |payload| found.push(payload.to_vec()));
        found
    }

    /// Payloads of one to three parts.
    fn payload() -> impl Strategy<Value = Vec<u8>> {
        let part = (any::<u8>(), vec(any::<u8>(), 1..20)).prop_map(|(id, data)| {
            let length = u8::try_from(data.len()).unwrap();
            [&[id, length][..], &data].concat()
        });
        vec(part, 1..4).prop_map(|parts| parts.concat())
    }

    #[test]
    fn frame_of_the_specification_is_built_and_found() {
        // Base control at 100 mm/s straight on: the sum of 06 01 04 64 00 00 00 is 67.
        let built = frame(&[0x01, 0x04, 0x64, 0x00, 0x00, 0x00]);
        assert_eq!(built, [0xAA, 0x55, 0x06, 0x01, 0x04, 0x64, 0x00, 0x00, 0x00, 0x67]);
        assert_eq!(payloads(&built), [[0x01, 0x04, 0x64, 0x00, 0x00, 0x00]]);
    }

    #[test]
    fn frame_behind_a_torn_one_is_found_although_it_lies_in_it() {
        let whole = frame(&[1, 1, 7]);
        // The length says that there are 200 bytes.
        let torn = [0xAA, 0x55, 200, 1, 2];
        let after = frame(&[&[4, 200][..], &[9; 200]].concat());
        assert_eq!(payloads(&[&torn[..], &whole, &after].concat()).len(), 2);
        let doubled = [&[0xAA, 0xAA, 0x55][..], &whole[2..]].concat();
        assert_eq!(payloads(&doubled), [[1, 1, 7]], "a header may follow its own first byte");
    }

    #[test]
    fn endless_noise_is_kept_in_bounds() {
        let mut frames = Frames::default();
        for byte in [0xAA, 0x55, 0xFF].into_iter().cycle().take(100_000) {
            frames.feed(&[byte], |_| {});
            assert!(frames.buffer.len() <= 255 + AROUND);
        }
        assert!(frames.rejected() > 0);
    }

    proptest! {
        #[test]
        fn any_split_of_a_stream_gives_the_same_frames(
            sent in vec(payload(), 1..8),
            noise in vec(any::<u8>(), 0..30),
            cuts in vec(any::<Index>(), 0..10),
        ) {
            let mut stream = noise;
            sent.iter().for_each(|payload| stream.extend(frame(payload)));
            let mut cuts: Vec<_> = cuts.iter().map(|cut| cut.index(stream.len())).collect();
            cuts.sort_unstable();
            let (mut frames, mut found, mut from) = (Frames::default(), Vec::new(), 0);
            for to in cuts.into_iter().chain([stream.len()]) {
                frames.feed(&stream[from..to], |payload| found.push(payload.to_vec()));
                from = to;
            }
            prop_assert_eq!(found, payloads(&stream));
        }

        #[test]
        fn what_is_sent_is_found(sent in vec(payload(), 1..8)) {
            let stream: Vec<_> = sent.iter().flat_map(|payload| frame(payload)).collect();
            prop_assert_eq!(payloads(&stream), sent);
        }

        /// Cuts bytes out of one frame or replaces them: all others are found. Sums by exclusive or can be right by
        /// chance, which the test excludes.
        #[test]
        fn corruption_costs_only_the_frames_that_it_touches(
            sent in vec(payload(), 3..8),
            which in any::<Index>(),
            at in any::<Index>(),
            instead in vec(any::<u8>(), 0..4),
            length in 1..4_usize,
        ) {
            let which = which.index(sent.len());
            let frames: Vec<_> = sent.iter().map(|payload| frame(payload)).collect();
            let broken = {
                let whole = &frames[which];
                let from = at.index(whole.len());
                let to = (from + length).min(whole.len());
                [&whole[..from], &instead, &whole[to..]].concat()
            };
            // Silence ends a frame whose length says that it is longer.
            let mut stream: Vec<_> = frames[..which].concat();
            stream.extend(&broken);
            stream.extend(frames[which + 1..].concat());
            stream.extend([0; 300]);
            let found = payloads(&stream);
            prop_assume!(found.iter().all(|payload| sent.contains(payload)));
            let whole = sent.iter().enumerate().filter(|(i, _)| *i != which).map(|(_, payload)| payload);
            let mut rest = found.iter();
            for payload in whole {
                prop_assert!(rest.any(|found| found == payload), "{payload:?} is lost of {sent:?}");
            }
        }

        #[test]
        fn noise_never_panics(bytes in vec(any::<u8>(), 0..2000)) {
            let found = payloads(&bytes);
            prop_assert!(found.len() * (SHORTEST + AROUND) <= bytes.len());
        }
    }
}
