;;; anmech: the parts of the names of files that a user gives.
;;;
;;; Entry points: SUFFIX-OF, STEM-OF; anmech_file_suffix, anmech_file_stem, anmech_file_alone.

(in-package :anmech)

(defun alone-of (file)
  "FILE without its folder."
  (subseq file (1+ (or (position #\/ file :from-end t) -1))))

(defun suffix-of (file)
  (let ((point (position #\. (alone-of file) :from-end t)))
    (if point (subseq (alone-of file) (1+ point)) "")))

(defun stem-of (file)
  "FILE without its folder and its suffix."
  (let ((point (position #\. (alone-of file) :from-end t)))
    (subseq (alone-of file) 0 point)))

(maxima::defmfun maxima::$anmech_file_suffix (file)
  "anmech_file_suffix(file): what stands behind the last point of its name."
  (coerce (suffix-of file) 'simple-string))

(maxima::defmfun maxima::$anmech_file_stem (file)
  "anmech_file_stem(file): with its folder, without its suffix."
  (coerce (subseq file 0 (+ (- (length file) (length (alone-of file))) (length (stem-of file)))) 'simple-string))

(maxima::defmfun maxima::$anmech_file_alone (file)
  "anmech_file_alone(file): without its folder."
  (coerce (alone-of file) 'simple-string))
