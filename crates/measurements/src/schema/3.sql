-- What is wrong with the robot: words with spaces between, as `absent`, `silent` or `flood`; NULL if nothing is.
ALTER TABLE robot ADD COLUMN health TEXT;
