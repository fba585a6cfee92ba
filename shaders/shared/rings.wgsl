// What the search for rows looks at.

// Rings of cells at most. What is still open then is left to the host, row by row.
const RINGS: i32 = 10;
const FREE: f32 = 1e36;
