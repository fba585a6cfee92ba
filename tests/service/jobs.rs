//! Promise: a job is created once per request, told as it was given, and hidden from other tenants; a watch tells every
//! event after a number and ends with the job.
