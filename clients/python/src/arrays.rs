//! Converts numpy arrays for the engine, and back.
//!
//! Invariant: arrays that come in are read where they lie, whatever their strides; arrays that go out are the engine's own
//! memory. A wrong shape, type or index is an InputError that names the argument. Must not know: what the arrays are for.

use bytemuck::allocation::cast_vec;
use glam::{DVec2, DVec3};
use numpy::ndarray::ArrayView2;
use numpy::{Element, PyArray1, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use tessera::mesh::numbers::NumberType;
use tessera::mesh::tensor::Tensor;
use tessera::rvd::on_threads_of;
use tessera::{Backend, TriMesh};

use crate::errors::input;

/// A surface from `vertices` (n, 3) and `faces` (m, 3), made on the threads of a backend: those of a forked process's parent
/// are not there.
pub(crate) fn mesh(vertices: &Bound<'_, PyAny>, faces: &Bound<'_, PyAny>, backend: &dyn Backend) -> PyResult<TriMesh> {
    let (positions, facets) = (points(vertices, "vertices")?, triples(faces, "faces")?);
    let made = faces.py().detach(|| on_threads_of(backend, || TriMesh::new(positions, facets)));
    made.map_err(input)
}

/// Coordinates x y z: (n, 3), float64 or float32.
pub(crate) fn points(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<DVec3>> {
    rows::<3>(array, name).map(|rows| rows.into_iter().map(DVec3::from_array).collect())
}

/// Coordinates u v: (n, 2), float64 or float32.
pub(crate) fn pairs(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<DVec2>> {
    rows::<2>(array, name).map(|rows| rows.into_iter().map(DVec2::from_array).collect())
}

/// Four numbers of each: (n, 4), float64 or float32.
pub(crate) fn fours(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<[f64; 4]>> {
    rows::<4>(array, name)
}

/// Metric tensors m11 m12 m22 m13 m23 m33: (n, 6), float64 or float32.
pub(crate) fn tensors(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<Tensor>> {
    rows::<6>(array, name).map(|rows| rows.into_iter().map(Tensor).collect())
}

fn rows<const N: usize>(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<[f64; N]>> {
    if let Ok(array) = array.extract::<PyReadonlyArray2<'_, f64>>() {
        return of_rows(array.as_array(), name, |x| x);
    }
    if let Ok(array) = array.extract::<PyReadonlyArray2<'_, f32>>() {
        return of_rows(array.as_array(), name, f64::from);
    }
    Err(input(format!("{name} is no array (n, {N}) of float64 or float32")))
}

fn of_rows<const N: usize, T: Copy, U>(
    view: ArrayView2<'_, T>,
    name: &str,
    change: impl Fn(T) -> U,
) -> PyResult<Vec<[U; N]>> {
    if view.ncols() != N {
        return Err(input(format!("{name} has the shape ({}, {}); (n, {N}) is needed", view.nrows(), view.ncols())));
    }
    Ok(view.rows().into_iter().map(|row| std::array::from_fn(|i| change(row[i]))).collect())
}

/// Three indices of each: (n, 3), integers.
pub(crate) fn triples(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<[u32; 3]>> {
    indices(array, name)
}

/// Two indices of each: (n, 2), integers.
pub(crate) fn edges(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<[u32; 2]>> {
    indices(array, name)
}

fn indices<const N: usize>(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<[u32; N]>> {
    let taken = indices_of::<N, i64>(array, name)
        .or_else(|| indices_of::<N, i32>(array, name))
        .or_else(|| indices_of::<N, u32>(array, name))
        .or_else(|| indices_of::<N, u64>(array, name));
    taken.unwrap_or_else(|| Err(input(format!("{name} is no array (n, {N}) of int64, int32, uint32 or uint64"))))
}

/// `None` if the array is of another type.
fn indices_of<const N: usize, T>(array: &Bound<'_, PyAny>, name: &str) -> Option<PyResult<Vec<[u32; N]>>>
where
    T: Copy + Element,
    u32: TryFrom<T>,
{
    let array = array.extract::<PyReadonlyArray2<'_, T>>().ok()?;
    let rows = of_rows::<N, T, _>(array.as_array(), name, |index| u32::try_from(index).ok());
    Some(rows.and_then(|rows| {
        let all = rows.into_iter().enumerate().map(|(row, indices)| {
            let mut taken = [0; N];
            for (into, index) in taken.iter_mut().zip(indices) {
                *into =
                    index.ok_or_else(|| input(format!("{name}[{row}] has an index that is negative or too large")))?;
            }
            Ok(taken)
        });
        all.collect()
    }))
}

/// A number of each: (n,), float64 or float32.
pub(crate) fn numbers(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<f64>> {
    if let Ok(array) = array.extract::<PyReadonlyArray1<'_, f64>>() {
        return Ok(array.as_array().to_vec());
    }
    if let Ok(array) = array.extract::<PyReadonlyArray1<'_, f32>>() {
        return Ok(array.as_array().iter().map(|&x| f64::from(x)).collect());
    }
    Err(input(format!("{name} is no array (n,) of float64 or float32")))
}

/// Words of the types of scalars.
const NUMBERS: [(&str, NumberType); 9] = [
    ("F64", NumberType::F64),
    ("U8", NumberType::U8),
    ("I8", NumberType::I8),
    ("U16", NumberType::U16),
    ("I16", NumberType::I16),
    ("U32", NumberType::U32),
    ("I32", NumberType::I32),
    ("U64", NumberType::U64),
    ("I64", NumberType::I64),
];

/// The type that a word names.
pub(crate) fn number(word: &str) -> PyResult<NumberType> {
    let found = NUMBERS.iter().find(|(known, _)| *known == word).map(|&(_, number)| number);
    found.ok_or_else(|| input(format!("{word} is no type of a scalar")))
}

/// The word of a type.
pub(crate) fn word(number: NumberType) -> &'static str {
    NUMBERS.iter().find(|(_, known)| *known == number).map_or("F64", |&(word, _)| word)
}

/// (n, 3) float64.
pub(crate) fn of_points(py: Python<'_>, points: Vec<DVec3>) -> PyResult<Bound<'_, PyAny>> {
    table(py, cast_vec::<DVec3, f64>(points), 3)
}

/// (n, 2) float64.
pub(crate) fn of_pairs(py: Python<'_>, pairs: Vec<DVec2>) -> PyResult<Bound<'_, PyAny>> {
    table(py, pairs.iter().flat_map(|p| p.to_array()).collect(), 2)
}

/// (n, 4) float64.
pub(crate) fn of_fours(py: Python<'_>, fours: Vec<[f64; 4]>) -> PyResult<Bound<'_, PyAny>> {
    table(py, cast_vec::<[f64; 4], f64>(fours), 4)
}

/// (n, N) int32: indices fit 31 bits.
pub(crate) fn of_indices<const N: usize>(py: Python<'_>, rows: Vec<[u32; N]>) -> PyResult<Bound<'_, PyAny>>
where
    [u32; N]: bytemuck::Pod,
{
    table(py, cast_vec::<[u32; N], i32>(rows), N)
}

/// (n,) int32.
pub(crate) fn of_counts(py: Python<'_>, values: Vec<u32>) -> Bound<'_, PyAny> {
    PyArray1::from_vec(py, cast_vec::<u32, i32>(values)).into_any()
}

/// (n,) float64.
pub(crate) fn of_numbers(py: Python<'_>, values: Vec<f64>) -> Bound<'_, PyAny> {
    PyArray1::from_vec(py, values).into_any()
}

fn table<T: Element>(py: Python<'_>, values: Vec<T>, columns: usize) -> PyResult<Bound<'_, PyAny>> {
    let rows = values.len() / columns;
    Ok(PyArray1::from_vec(py, values).reshape([rows, columns])?.into_any())
}
