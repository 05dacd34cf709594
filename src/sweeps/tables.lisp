;;; anmech: what is read off the results of a sweep, in one go through them: tables, files, and the numbers of pictures.
;;;
;;; A line of the table is a list: the point, the cells of a row, the estimate of the error, the status.  A point whose
;;; motion was none has a line, too, with unknown in its cells.
;;;
;;; Entry points: anmech_sweep_lines, anmech_write_sweep, anmech_sweep_bounds, anmech_sweep_bins, anmech_sweep_cells,
;;; anmech_sweep_places, anmech_sweep_statuses.

(in-package :anmech)
(needs "session/texts" "session/whole_files" "algebra/terms" "numerics/dag" "numerics/evaluation"
       "numerics/registers" "sweeps/chunks")

(defun map-lines (function results width &optional (from 0) (to (results-count results)))
  "FUNCTION of the number of the point and the line, for each line."
  (let ((nothing (make-list width :initial-element 'maxima::$unknown)))
    (map-results (lambda (number result)
                   (destructuring-bind (end error status rows) (rest result)
                     (declare (ignore end))
                     (let ((point (point-of results number)))
                       (dolist (row (or (mapcar #'rest (rest rows)) (list nothing)))
                         (funcall function number (append point row (and error (list error)) (list status)))))))
                 results from to)))

(maxima::defmfun maxima::$anmech_sweep_lines (results width from to)
  "anmech_sweep_lines(results, width, from, to): the lines of the points from FROM, counted from 1, to TO."
  (let ((lines '()))
    (map-lines (lambda (number line) (declare (ignore number)) (push (maxima-list line) lines)) results width (1-
      from) to)
    (maxima-list (nreverse lines))))

(maxima::defmfun maxima::$anmech_sweep_statuses (results most)
  "anmech_sweep_statuses(results, most): [how many points came to their end, how many did not, the first MOST
sentences]."
  (let ((complete 0) (others 0) (sentences '()))
    (map-results (lambda (number result)
                   (cond ((member (fourth result) *plain-statuses*) (incf complete))
                         (t (incf others)
                            (when (<= others most)
                              (push (maxima-list (list (1+ number) (fourth result))) sentences)))))
                 results)
    (maxima-list (list complete others (maxima-list (nreverse sentences))))))

;;; Files

(defun quoted-field (text)
  "TEXT as a field of a table of comma-separated values."
  (with-output-to-string (out)
    (write-char #\" out)
    (loop for char across text
          do (when (char= char #\") (write-char #\" out))
             (write-char char out))
    (write-char #\" out)))

(defun field-text (cell)
  (cond ((floatp cell) (let ((*read-default-float-format* 'double-float)) (prin1-to-string cell)))
        ((integerp cell) (format nil "~d" cell))
        (t (let ((text (if (stringp cell) cell (plain-name cell))))
             (if (find-if (lambda (char) (find char ",\"
")) text)
                 (quoted-field text)
                 text)))))

(defun line-of-fields (cells)
  (with-output-to-string (out)
    (loop for (cell . more) on cells
          do (write-string (field-text cell) out)
             (when more (write-char #\, out)))))

(maxima::defmfun maxima::$anmech_write_sweep (file names results width)
  "anmech_write_sweep(file, [name, ...], results, width): comma-separated values; doubles read back exactly.  The file
holds all of them, or is as it was."
  (flet ((tell-lines (tell)
           (funcall tell (line-of-fields (rest names)))
           (map-lines (lambda (number line)
                        (declare (ignore number))
                        (funcall tell (line-of-fields line)))
                      results width)))
    (write-file file #'tell-lines)
    file))

;;; Numbers of expressions in the columns

(defun map-numbers (function registers results width)
  "FUNCTION of the number of the point and the list of doubles that REGISTERS compute of a line without its status;
lines with what is no number, or for which there are none, are passed over."
  (let ((inputs (registers-numbers registers)))
    (map-lines (lambda (number line)
                 (let ((cells (butlast line)))
                   (when (every #'realp (butlast cells))
                     (loop for cell in cells
                           for place from 0
                           do (setf (aref inputs place)
                                    (cond ((floatp cell) cell) ((integerp cell) (to-double cell)) (t 0d0))))
                     (let ((found (handler-case (progn (run-registers registers) (result-list registers))
                                    ((or domain-violation arithmetic-error) () nil))))
                       (when (and found (every (lambda (x) (and (= x x) (<= (abs x) most-positive-double-float)))
                         found))
                         (funcall function number found))))))
               results width)))

(maxima::defmfun maxima::$anmech_sweep_bounds (registers results width)
  "anmech_sweep_bounds(evaluator, results, width): [[least, largest], ...] of each expression; [] where none has a
  value."
  (let ((low nil) (high nil))
    (map-numbers (lambda (number found)
                   (declare (ignore number))
                   (setq low (if low (mapcar #'min low found) found)
                         high (if high (mapcar #'max high found) found)))
                 registers results width)
    (maxima-list (mapcar (lambda (a b) (numbers-list (list a b))) low high))))

(maxima::defmfun maxima::$anmech_sweep_bins (registers results width low high bins)
  "anmech_sweep_bins(evaluator, results, width, low, high, bins): how many values of the first expression lie in each
  of so many
equal parts of [LOW, HIGH]."
  (let ((counts (make-array bins :initial-element 0)) (size (- high low)))
    (map-numbers (lambda (number found)
                   (declare (ignore number))
                   (incf (aref counts (min (1- bins) (max 0 (floor (* bins (- (first found) low)) size))))))
                 registers results width)
    (maxima-list (coerce counts 'list))))

(maxima::defmfun maxima::$anmech_sweep_cells (registers results width counts most)
  "anmech_sweep_cells(evaluator, results, width, [m, n], most): rows, the highest first, of the means of the first
expression over a grid of m times n points, in at most MOST cells each way; false where there is none."
  (destructuring-bind (m n) (rest counts)
    (let* ((columns (min m most)) (rows (min n most))
           (sums (make-array (list rows columns) :initial-element 0d0))
           (weights (make-array (list rows columns) :initial-element 0)))
      (map-numbers (lambda (number found)
                     (multiple-value-bind (i j) (floor number n)
                       (let ((row (floor (* j rows) n)) (column (floor (* i columns) m)))
                         (incf (aref sums row column) (first found))
                         (incf (aref weights row column)))))
                   registers results width)
      (maxima-list (loop for row from (1- rows) downto 0
                         collect (maxima-list (loop for column below columns
                                                    for weight = (aref weights row column)
                                                    collect (and (plusp weight)
                                                                 (/ (aref sums row column) weight)))))))))

(maxima::defmfun maxima::$anmech_sweep_places (registers results width most)
  "anmech_sweep_places(evaluator, results, width, most): for each of about MOST points at most its number, from 0, and
the list of the lists of values on its lines."
  (let ((curves '()) (stride (max 1 (ceiling (results-count results) most))))
    (map-numbers (lambda (number found)
                   (when (zerop (mod number stride))
                     (unless (eql number (car (first curves))) (push (list number) curves))
                     (push (numbers-list found) (cdr (first curves)))))
                 registers results width)
    (maxima-list (loop for (number . places) in (nreverse curves)
                       collect (maxima-list (list number (maxima-list (nreverse places))))))))
