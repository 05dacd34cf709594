;;; anmech: what is read off the results of a sweep, in one go through them: tables, files, and the numbers of pictures.
;;;
;;; A line of the table is a list: the point, the cells of a row, the estimate of the error, the status.  A point whose
;;; motion was none has a line, too, with unknown in its cells.
;;;
;;; Entry points: anmech_sweep_lines, anmech_write_sweep, anmech_sweep_bounds, anmech_sweep_bins, anmech_sweep_cells,
;;; anmech_sweep_curves, anmech_sweep_statuses.

(in-package :anmech)
(needs "session/texts" "session/whole_files" "algebra/terms" "numerics/dag" "numerics/evaluation"
       "numerics/registers" "sweeps/chunks" "sweeps/grids")

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

;;; Curves
;;;
;;; More than can be seen is thinned, evenly in the numbers of each axis and in the places of each curve: every n-th
;;; line of the table would belong to the same few values of the last name, which run fastest.

(defstruct (curve (:constructor make-curve (number room)))
  "Of the places on a curve, one at random of each STRIDE that follow one another, and the last one: of kinds of lines
that alternate, every n-th would be all of one kind.  ROOM is even."
  number room (places '()) (count 0) (seen 0) (stride 1) (chosen 0) last)

(defun chosen-in-part (part stride &optional (seed 0))
  (+ (* part stride) (if (or (zerop part) (= stride 1)) 0 (mod (bits-of part seed) stride))))

(defun bits-of (part seed)
  "Others on each curve: the same places of many curves would be stripes."
  (mixed-bits (+ part (* 1000003 seed))))

(defun add-place (curve place)
  (when (= (curve-seen curve) (curve-chosen curve))
    (when (>= (curve-count curve) (curve-room curve)) (halve-curve curve))
    (push place (curve-places curve))
    (incf (curve-count curve))
    (setf (curve-chosen curve)
          (chosen-in-part (1+ (floor (curve-seen curve) (curve-stride curve))) (curve-stride curve)
                          (curve-number curve))))
  (incf (curve-seen curve))
  (setf (curve-last curve) place))

(defun halve-curve (curve)
  "One of two neighbours stays, the first place in any case; the parts, one place of each, are twice as large."
  (setf (curve-places curve) (nreverse (loop for part from 0
                                             for (one other) on (nreverse (curve-places curve)) by #'cddr
                                             collect (if (or (zerop part)
                                                             (evenp (bits-of part (curve-number curve))))
                                                         one
                                                         other)))
        (curve-count curve) (/ (curve-count curve) 2)
        (curve-stride curve) (* 2 (curve-stride curve))))

(defun places-along (curve)
  (let ((places (curve-places curve)) (last (curve-last curve)))
    (reverse (if (eq (first places) last) places (cons last places)))))

(defun chosen-p (place count wanted)
  "Whether PLACE, of COUNT numbered from 0, is among WANTED ones at equal distances."
  (cond ((>= wanted count) t)
        ((= wanted 1) (zerop place))
        (t (let ((distance (/ (1- count) (1- wanted))))
             (= place (round (* (round place distance) distance)))))))

(defun thinned-lengths (lengths most)
  "How many places of axes of these LENGTHS make at most MOST combinations: the longest ones lose most."
  (let ((wanted (make-list (length lengths))) (left (max 1 most)) (axes (length lengths)))
    (loop for (length . place) in (sort (loop for length in lengths for place from 0 collect (cons length place))
                                        #'< :key #'car)
          for some = (max 1 (min length (if (= axes 1) left (floor (expt (to-double left) (/ 1d0 axes))))))
          do (setf (nth place wanted) some
                   left (floor left some))
             (decf axes))
    wanted))

(defun places-on-axes (number lengths)
  "The places on axes of these LENGTHS of the point NUMBER of their product."
  (let ((places '()))
    (dolist (length (reverse lengths) places)
      (multiple-value-bind (quotient place) (floor number length)
        (push place places)
        (setq number quotient)))))

(defun choice-of-curves (results along most)
  "A function of the number of a point: the number of the first point of its curve, or nil where there are more than
MOST curves and it is on none that is drawn.  ALONG: true, one curve through all points; false, one for each point; a
number, one along that axis of a product for each combination of the other axes."
  (let ((lengths (and (eq (results-way results) 'maxima::$product) (mapcar #'axis-length (results-axes results))))
        (count (results-count results)))
    (cond ((eq along t) (constantly 0))
          (lengths
           (let* ((length (if along (elt lengths (1- along)) 1))
                  (step (if along (reduce #'* (nthcdr along lengths)) 1))
                  (others (loop for length in lengths for k from 1 collect (if (eql k along) 1 length)))
                  (wanted (thinned-lengths others most))
                  (all (equal others wanted)))
             (lambda (number)
               (let ((first (- number (* step (mod (floor number step) length)))))
                 (and (or all (every #'chosen-p (places-on-axes first lengths) others wanted)) first)))))
          (t (let ((stride (ceiling count most)))
               (lambda (number)
                 (and (= number (chosen-in-part (floor number stride) stride)) number)))))))

(maxima::defmfun maxima::$anmech_sweep_curves (registers results width along most room)
  "anmech_sweep_curves(evaluator, results, width, along, most, room): of at most MOST curves the number of the first
point, from 0, and the list of the lists of values on its lines, about ROOM at most.  ALONG: true, one curve through
all points; false, one for each point; k, one along the k-th name of a product for each combination of the others."
  (let ((curves '()) (table (make-hash-table)) (choice (choice-of-curves results along most)))
    (declare (type function choice))
    (map-numbers (lambda (number found)
                   (let ((first (funcall choice number)))
                     (when first
                       (add-place (or (gethash first table)
                                      (let ((curve (make-curve first (* 2 (ceiling room 2)))))
                                        (push curve curves)
                                        (setf (gethash first table) curve)))
                                  found))))
                 registers results width)
    (maxima-list (loop for curve in (nreverse curves)
                       collect (maxima-list (list (curve-number curve)
                                                  (maxima-list (mapcar #'numbers-list (places-along curve)))))))))
