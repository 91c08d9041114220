//! Snapshots of a vector.

use super::VectorEnv;
use crate::error::SimError;
use crate::snapshot::{Reader, Snapshot, SnapshotError, Writer, seal};

impl VectorEnv {
    /// Bytes in a [`snapshot`](Self::snapshot).
    #[must_use]
    pub fn snapshot_len(&self) -> usize {
        let env_id = self.spec.env_id.to_string();
        self.head(&env_id, 0).head().len() + self.num_envs * self.env_len()
    }

    /// Bytes of one environment: its own, and whether its episode has ended.
    fn env_len(&self) -> usize {
        let first = self.pieces.iter().next();
        first
            .and_then(|piece| piece.slots.first().map(|slot| slot.env.snapshot_len() + 1))
            .unwrap_or(0)
    }

    fn head<'a>(&self, env_id: &'a str, tag: u8) -> Snapshot<'a> {
        Snapshot {
            env_id,
            num_envs: self.num_envs,
            options: self.options,
            scene: self.spec.scene,
            tag,
            was_reset: self.was_reset,
            scene_crc: self.task.scene().crc() ^ self.sight.crc(&self.spec),
            envs: &[],
        }
    }

    /// Everything that decides what comes next, as bytes, with a `tag` of the caller's own.
    #[must_use]
    pub fn snapshot(&self, tag: u8) -> Vec<u8> {
        let env_id = self.spec.env_id.to_string();
        let mut writer = Writer { bytes: self.head(&env_id, tag).head() };
        writer.bytes.reserve_exact(self.num_envs * self.env_len());
        for piece in self.pieces.iter() {
            for slot in &piece.slots {
                slot.env.save(&mut writer);
                writer.bytes.push(u8::from(slot.is_over));
            }
        }
        seal(&mut writer.bytes);
        writer.bytes
    }

    /// Goes on from where a [`snapshot`](Self::snapshot) was taken, of these environments or of
    /// others of their kind. The tag is the caller's business.
    ///
    /// # Errors
    /// [`SimError::Snapshot`] if it is one of something else or malformed; then nothing has
    /// changed.
    pub fn restore(&mut self, snapshot: &Snapshot<'_>) -> Result<(), SimError> {
        let env_id = self.spec.env_id.to_string();
        let ours = self.head(&env_id, snapshot.tag);
        let pairs = [
            ("environment", format!("{:?}", snapshot.env_id), format!("{:?}", ours.env_id)),
            ("num_envs", snapshot.num_envs.to_string(), ours.num_envs.to_string()),
            ("scene", format!("{:08x}", snapshot.scene_crc), format!("{:08x}", ours.scene_crc)),
            (
                "autoreset mode",
                format!("{:?}", snapshot.options.autoreset_mode),
                format!("{:?}", ours.options.autoreset_mode),
            ),
            (
                "handling of actions out of bounds",
                format!("{:?}", snapshot.options.out_of_bounds),
                format!("{:?}", ours.options.out_of_bounds),
            ),
            ("scene options", format!("{:?}", snapshot.scene), format!("{:?}", ours.scene)),
            (
                "length",
                format!("{} bytes", snapshot.envs.len()),
                format!("{} bytes", self.num_envs * self.env_len()),
            ),
        ];
        if let Some((what, got, want)) = pairs.into_iter().find(|(_, got, want)| got != want) {
            return Err(SnapshotError::Mismatch { what, got, want }.into());
        }
        let mut reader = Reader { rest: snapshot.envs };
        let mut saved = Vec::with_capacity(self.num_envs);
        for piece in self.pieces.iter() {
            for slot in &piece.slots {
                saved.push((slot.env.read(&mut reader)?, reader.flag("is_over")?));
            }
        }
        self.was_reset = snapshot.was_reset;
        let mut saved = saved.into_iter();
        for mut piece in self.pieces.iter() {
            for (slot, (env, is_over)) in piece.slots.iter_mut().zip(&mut saved) {
                slot.is_over = is_over;
                slot.env.restore(env);
            }
        }
        Ok(())
    }
}
