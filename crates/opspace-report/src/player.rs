//! Player of a run in its page: code that a script unpacks, and the data of the run.
//!
//! The code is built from TypeScript in `crates/opspace-live/page`. Without scripts the player stays hidden, and the page has the views
//! of the arm.

use crate::run_pictures::{RunPictures, json};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

/// Code of the player, compressed with gzip.
const CODE: &[u8] = include_bytes!("player/player.js.gz");
/// Hash of the code before compression, as a policy states it.
pub(crate) const CODE_HASH: &str = include_str!("player/player.js.sha256");
/// Script that unpacks the code.
pub(crate) const LOADER: &str = include_str!("player/load_player.js");

/// Place of the player in the page.
pub(crate) const PLACE: &str = "<div class=\"player\" hidden=\"\"></div>";

/// Elements at the end of the page: data of the robots and code, which are no scripts for the browser, and the script that unpacks them.
/// `are_compared`: all robots have the same task.
pub(crate) fn scripts(robots: &[(&str, &RunPictures)], are_compared: bool) -> String {
    format!(
        "<script type=\"application/json\" id=\"player-data\">{}</script>\n\
         <script type=\"application/gzip\" id=\"player-code\">{}</script>\n<script>{LOADER}</script>\n",
        json(robots, are_compared),
        STANDARD.encode(CODE)
    )
}
