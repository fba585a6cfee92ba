//! Zip archives, for tests of 3MF.

/// An archive of parts that are not compressed.
pub fn stored(parts: &[(&str, &str)]) -> Vec<u8> {
    let (mut out, mut entries) = (Vec::new(), Vec::new());
    for (name, text) in parts {
        let mut sum = flate2::Crc::new();
        sum.update(text.as_bytes());
        let length = (text.len() as u32).to_le_bytes();
        // Version, flags, method, time and date; the sum and the lengths; no extra field.
        let mut head = [20u16, 0, 0, 0, 0x21].iter().flat_map(|n| n.to_le_bytes()).collect::<Vec<u8>>();
        head.extend(sum.sum().to_le_bytes());
        head.extend([length, length].concat());
        head.extend((name.len() as u16).to_le_bytes());
        head.extend([0; 2]);
        entries.extend(b"PK\x01\x02\x14\0");
        entries.extend(&head);
        entries.extend([0; 10]);
        entries.extend((out.len() as u32).to_le_bytes());
        entries.extend(name.as_bytes());
        out.extend(b"PK\x03\x04");
        out.extend(head);
        out.extend(name.as_bytes());
        out.extend(text.as_bytes());
    }
    let (begin, count) = (out.len() as u32, parts.len() as u16);
    let length = entries.len() as u32;
    out.extend(entries);
    out.extend(b"PK\x05\x06\0\0\0\0");
    out.extend([count, count].iter().flat_map(|n| n.to_le_bytes()));
    out.extend([length, begin].iter().flat_map(|n| n.to_le_bytes()));
    out.extend([0; 2]);
    out
}
