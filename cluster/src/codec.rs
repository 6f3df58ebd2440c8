//! Values as bytes, for messages and for the heads of files.
//!
//! The one place that knows which encoding that is. Whoever reads bytes that somebody else wrote
//! says how many a value may ask for, so that a length that lies costs nothing.

use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

/// Bytes that are no value of the kind expected.
#[derive(Debug, Error)]
#[error("{0}")]
pub struct CodecError(String);

/// A value as bytes.
///
/// # Errors
/// A value that cannot be written, such as a sequence of unknown length.
pub fn encode<T: Serialize>(value: &T) -> Result<Vec<u8>, CodecError> {
    bincode::serde::encode_to_vec(value, bincode::config::standard())
        .map_err(|error| CodecError(error.to_string()))
}

/// The value that `bytes` are, which may ask for at most `LIMIT` bytes of memory.
///
/// # Errors
/// Bytes that are no such value, ask for more, or go on behind it.
pub fn decode<T: DeserializeOwned, const LIMIT: usize>(bytes: &[u8]) -> Result<T, CodecError> {
    let config = bincode::config::standard().with_limit::<LIMIT>();
    match bincode::serde::decode_from_slice(bytes, config) {
        Ok((value, read)) if read == bytes.len() => Ok(value),
        Ok((_, read)) => Err(CodecError(format!("{} bytes too many", bytes.len() - read))),
        Err(error) => Err(CodecError(error.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    type Value = (u64, String, Vec<f32>, Option<(bool, char)>);

    proptest! {
        #[test]
        fn values_come_back_and_no_bytes_do_harm(
            number in any::<u64>(), text in ".{0,9}", list in proptest::collection::vec(any::<i16>(), 0..9),
            at in any::<prop::sample::Index>(), byte in any::<u8>(),
        ) {
            let list: Vec<f32> = list.into_iter().map(f32::from).collect();
            let value: Value = (number, text, list, Some((true, 'x')));
            let mut bytes = encode(&value).unwrap();
            prop_assert_eq!(&decode::<Value, 4096>(&bytes).unwrap(), &value);
            prop_assert!(decode::<Value, 4096>(&bytes[..bytes.len() - 1]).is_err());
            let place = at.index(bytes.len());
            bytes[place] = byte;
            let _ = decode::<Value, 4096>(&bytes);
            bytes.push(0);
            let _ = decode::<Value, 4096>(&bytes);
        }
    }

    #[test]
    fn a_length_that_lies_is_refused() {
        let lie = encode(&u64::MAX).unwrap();
        assert!(decode::<Vec<u64>, 4096>(&lie).is_err());
        assert!(decode::<String, 4096>(&lie).is_err());
        let long = encode(&vec![0_u64; 10_000]).unwrap();
        assert!(decode::<Vec<u64>, 4096>(&long).is_err());
    }
}
