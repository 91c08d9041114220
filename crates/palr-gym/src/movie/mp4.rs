//! Films as MP4: H.264 that browsers play.

use std::num::NonZeroU32;

use anyhow::Context;
use openh264::OpenH264API;
use openh264::encoder::{
    Encoder, EncoderConfig, FrameRate, FrameType, IntraFramePeriod, RateControlMode,
};
use openh264::formats::{RgbSliceU8, YUVBuffer};
use shiguredo_mp4::TrackKind;
use shiguredo_mp4::bitstream::h264::{
    H264SampleEntryConfig, LengthSize, annexb_to_length_prefixed, build_avc1_box_from_annexb,
};
use shiguredo_mp4::boxes::SampleEntry;
use shiguredo_mp4::mux::{Mp4FileMuxer, Sample};

/// Seconds from one picture that stands alone to the next.
const KEYFRAMES_S: u32 = 5;
/// The encoder knows no smaller sides.
const LEAST_SIDE_PX: usize = 16;

/// An MP4 file that is being put together. Pictures are `[height, width, 3]`.
pub struct Mp4 {
    /// Of the pictures.
    width_px: usize,
    height_px: usize,
    /// Of the film: even, as its format wants them.
    padded: (usize, usize),
    fps: NonZeroU32,
    encoder: Encoder,
    muxer: Mp4FileMuxer,
    file: Vec<u8>,
}

impl Mp4 {
    pub fn new(width_px: usize, height_px: usize, fps: u32) -> anyhow::Result<Self> {
        let fps = NonZeroU32::new(fps).unwrap_or(NonZeroU32::MIN);
        let padded = [width_px, height_px].map(|side| side.next_multiple_of(2).max(LEAST_SIDE_PX));
        let config = EncoderConfig::new()
            .skip_frames(false)
            // Every picture as good as the others, whatever the size of the file.
            .rate_control_mode(RateControlMode::Off)
            .max_frame_rate(FrameRate::from_hz(fps.get() as f32))
            .intra_frame_period(IntraFramePeriod::from_num_frames(KEYFRAMES_S * fps.get()))
            // Equal pictures give equal files, whatever the machine's cores.
            .num_threads(1);
        let encoder = Encoder::with_api_config(OpenH264API::from_source(), config)?;
        let muxer = Mp4FileMuxer::new()?;
        let file = muxer.initial_boxes_bytes().to_vec();
        let padded = (padded[0], padded[1]);
        Ok(Self { width_px, height_px, padded, fps, encoder, muxer, file })
    }

    /// Adds a picture.
    pub fn add(&mut self, rgb: &[u8]) -> anyhow::Result<()> {
        let picture = self.pad(rgb);
        let yuv = YUVBuffer::from_rgb8_source(RgbSliceU8::new(&picture, self.padded));
        let encoded = self.encoder.encode(&yuv)?;
        let keyframe = matches!(encoded.frame_type(), FrameType::IDR);
        let stream = encoded.to_vec();
        let length_size = LengthSize::FourBytes;
        // What a decoder has to know comes with each picture that stands alone.
        let sample_entry = if keyframe {
            let config = H264SampleEntryConfig { length_size };
            Some(SampleEntry::Avc1(build_avc1_box_from_annexb(&stream, &config)?))
        } else {
            None
        };
        let data = annexb_to_length_prefixed(&stream, length_size)?;
        self.muxer.append_sample(&Sample {
            track_kind: TrackKind::Video,
            sample_entry,
            keyframe,
            timescale: self.fps,
            duration: 1,
            composition_time_offset: None,
            data_offset: self.file.len() as u64,
            data_size: data.len(),
        })?;
        self.file.extend_from_slice(&data);
        Ok(())
    }

    /// The file.
    pub fn finish(mut self) -> anyhow::Result<Vec<u8>> {
        let boxes = self.muxer.finalize()?;
        for (offset, bytes) in boxes.offset_and_bytes_pairs() {
            let begin = usize::try_from(offset).context("the film is too long")?;
            let end = begin + bytes.len();
            if self.file.len() < end {
                self.file.resize(end, 0);
            }
            self.file[begin..end].copy_from_slice(bytes);
        }
        Ok(self.file)
    }

    /// The picture with its last column and row repeated as far as the film is larger.
    fn pad(&self, rgb: &[u8]) -> Vec<u8> {
        let (width, height) = self.padded;
        let mut picture = Vec::with_capacity(3 * width * height);
        for y in 0..height {
            let row = 3 * self.width_px * y.min(self.height_px - 1);
            for x in 0..width {
                let pixel = row + 3 * x.min(self.width_px - 1);
                picture.extend_from_slice(&rgb[pixel..pixel + 3]);
            }
        }
        picture
    }
}

#[cfg(test)]
mod tests {
    use openh264::decoder::Decoder;
    use openh264::formats::YUVSource;
    use shiguredo_mp4::bitstream::h264::length_prefixed_to_annexb;
    use shiguredo_mp4::demux::{Input, Mp4FileDemuxer};

    use super::*;

    const FPS: u32 = 20;
    const PICTURES: usize = 130;

    /// A bright square that wanders over a slope of colours.
    fn picture(width: usize, height: usize, k: usize) -> Vec<u8> {
        let mut rgb = Vec::new();
        for y in 0..height {
            for x in 0..width {
                let is_square = (x + width - k % width) % width < 8 && (8..16).contains(&y);
                let slope = [x * 200 / width, y * 200 / height, 90].map(|value| value as u8);
                rgb.extend(if is_square { [240, 230, 40] } else { slope });
            }
        }
        rgb
    }

    fn film(width: usize, height: usize) -> Vec<u8> {
        let mut film = Mp4::new(width, height, FPS).unwrap();
        for k in 0..PICTURES {
            film.add(&picture(width, height, k)).unwrap();
        }
        film.finish().unwrap()
    }

    /// Another's demuxer and decoder find every picture, in order and hardly changed.
    fn check(width: usize, height: usize) {
        let file = film(width, height);
        let mut demuxer = Mp4FileDemuxer::new();
        demuxer.handle_input(Input { position: 0, data: &file });
        let tracks = demuxer.tracks().unwrap();
        assert_eq!((tracks.len(), tracks[0].kind), (1, TrackKind::Video));
        let mut decoder = Decoder::new().unwrap();
        let (mut decoded, mut keyframes) = (0, 0);
        while let Some(sample) = demuxer.next_sample().unwrap() {
            assert_eq!((sample.track.timescale.get(), sample.duration), (FPS, 1));
            assert_eq!(sample.timestamp, decoded as u64);
            keyframes += usize::from(sample.keyframe);
            let begin = sample.data_offset as usize;
            let data = &file[begin..begin + sample.data_size];
            let stream = length_prefixed_to_annexb(data, LengthSize::FourBytes).unwrap();
            let picture_read = decoder.decode(&stream).unwrap().unwrap();
            let (read_width, read_height) = picture_read.dimensions();
            assert!(read_width >= width && read_height >= height);
            let mut rgb = vec![0; 3 * read_width * read_height];
            picture_read.write_rgb8(&mut rgb);
            let original = picture(width, height, decoded);
            let mut difference = 0_u64;
            for (row, original) in
                rgb.chunks_exact(3 * read_width).zip(original.chunks_exact(3 * width))
            {
                let pairs = row.iter().zip(original);
                difference += pairs.map(|(a, b)| u64::from(a.abs_diff(*b))).sum::<u64>();
            }
            let mean = difference as f64 / (3 * width * height) as f64;
            // The next picture's square is elsewhere by a pixel: a shift in time would show.
            assert!(mean < 6.0, "{width} x {height}, picture {decoded}: {mean}");
            decoded += 1;
        }
        assert_eq!((decoded, keyframes), (PICTURES, 2));
    }

    #[test]
    fn a_film_has_all_its_pictures() {
        check(64, 48);
    }

    #[test]
    fn odd_and_tiny_pictures_are_padded() {
        check(63, 33);
        assert!(!film(1, 1).is_empty());
    }

    #[test]
    fn equal_pictures_give_equal_files() {
        assert!(film(48, 48) == film(48, 48));
    }
}
