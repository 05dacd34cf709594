;;; anmech: systems of linear equations in doubles of which the pattern is known beforehand, solved again and again.
;;;
;;; The order of the pivots is chosen once: few new entries (Markowitz), and pivots that are not small at a sample of
;;; numbers.  A matrix that is symmetric, and positive definite there, is taken by its upper half.  What elimination
;;; does then is one list of places, which a short loop runs through: nothing is compiled, and no zero is touched.
;;;
;;; Such an order is not safe for all numbers.  Pivots of a symmetric matrix that are all positive prove that it is
;;; positive definite, and then elimination is stable in any order.  Of other solutions the residual is looked at: where
;;; rounding of the single entries can make it, the solution is as good as any (Oettli and Prager).  Otherwise it is
;;; corrected once or twice by the same factors, which mends mild growth (Skeel).  Where that does not help, or a pivot
;;; is negligible, the equations are solved with a choice of pivots (linear.lisp), which also decides whether they are
;;; singular.  So what comes out depends on the equations alone, not on those solved before.
;;;
;;; Entry points: the structure ELIMINATION; PLANNED-ELIMINATION, PIVOTING-ELIMINATION; MAKE-LINEAR-SOLVER.
;;;
;;; Literature: H. M. Markowitz, Management Science 3 (1957) 255-269; W. Oettli, W. Prager, Numer. Math. 6 (1964)
;;; 405-409; R. D. Skeel, Math. Comp. 35 (1980) 817-832; M. Arioli, J. W. Demmel, I. S. Duff, SIAM J. Matrix Anal.
;;; Appl. 10 (1989) 165-190; X. S. Li, J. W. Demmel, ACM Trans. Math. Software 29 (2003) 110-140 (static pivots).

(in-package :anmech)
(needs "arithmetic/floats" "arithmetic/linear")

(defun places (list)
  (make-array (length list) :element-type 'fixnum :initial-contents list))

(defstruct elimination
  "Of SIZE equations, the order of the pivots; the entries of the matrix come in the order of ROWS and COLUMNS."
  size
  rows columns       ; nil: all entries of the matrix are there
  symmetric          ; whether the entries are those of the upper half
  fill               ; how many places more the factors take than the matrix
  measure            ; for each pivot: how many entries its size is compared with, and their places
  factor             ; for each pivot: its place, how many entries below; for each of these: its place, how many
                     ; entries of the pivot's row are taken from its row; for each: the place changed, the pivot's
  forward            ; for each pivot: its row, how many entries below; for each of these: its place and row
  backward)          ; for each pivot, the last first: its column, how many entries right; their places and columns

;;; The order of the pivots

(defstruct front
  "The part of a matrix that is not eliminated yet, by lists, and numbers for a sample of the whole."
  size values          ; SIZE by SIZE doubles, by rows
  places               ; of the entries, likewise; -1 where there is none
  (count 0)            ; of the places
  right                ; for each row the columns in which it has entries
  below                ; for each column the rows
  symmetric)

(defun number-at (front i j) (aref (front-values front) (+ j (* i (front-size front)))))
(defun place-at (front i j) (aref (front-places front) (+ j (* i (front-size front)))))

(defun note-entry (front i j place)
  (setf (aref (front-places front) (+ j (* i (front-size front)))) place)
  (push j (aref (front-right front) i))
  (push i (aref (front-below front) j)))

(defun add-entry (front i j)
  "A new place for row I and column J; in a symmetric matrix also for its mirror image."
  (let ((place (front-count front)))
    (setf (front-count front) (1+ place))
    (note-entry front i j place)
    (when (and (front-symmetric front) (/= i j)) (note-entry front j i place))))

(defun first-front (size rows columns values symmetric)
  (let ((front (make-front :size size :symmetric symmetric
                           :values (make-array (* size size) :element-type 'double-float :initial-element 0d0)
                           :places (make-array (* size size) :element-type 'fixnum :initial-element -1)
                           :right (make-array size :initial-element '())
                           :below (make-array size :initial-element '()))))
    (loop for i in rows
          for j in columns
          for value in values
          do (add-entry front i j)
             (setf (aref (front-values front) (+ j (* i size))) value)
             (when symmetric (setf (aref (front-values front) (+ i (* j size))) value)))
    front))

(defun largest-in (front places i-or-nil j-or-nil)
  "The largest size of an entry in row I or column J."
  (reduce #'max (mapcar (lambda (k) (abs (number-at front (or i-or-nil k) (or j-or-nil k)))) places)
          :initial-value 0d0))

(defun diagonal-pivot (front sizes)
  "The entry of the diagonal that has the fewest others beside it; nil if one is not positive at the sample."
  (let ((best nil) (least nil))
    (dotimes (i (front-size front) (and best (cons best best)))
      (let ((beside (aref (front-right front) i)))
        (when beside
          (unless (and (member i beside) (> (number-at front i i) (* 1d-10 (aref sizes i))))
            (return nil))
          (when (or (null least) (< (length beside) least))
            (setq best i least (length beside))))))))

(defun any-pivot (front sizes)
  "The entry that makes the fewest new ones, of those that are not small at the sample, in proportion to their rows,
against others of their columns."
  (let ((best nil) (least nil) (lengths (map 'vector #'length (front-right front))))
    (flet ((share (i j) (/ (abs (number-at front i j)) (aref sizes i))))
      (dotimes (j (front-size front) best)
        (let* ((column (aref (front-below front) j))
               (others (1- (length column)))
               (largest (reduce #'max (mapcar (lambda (i) (share i j)) column) :initial-value 0d0)))
          (dolist (i column)
            (let ((cost (* others (1- (aref lengths i)))))
              (when (and (or (null least) (< cost least))
                         (> (share i j) 1d-10)
                         (>= (share i j) (* 0.05d0 largest)))
                (setq best (cons i j) least cost)))))))))

(defun take-out-pivot (front row column)
  "Eliminate COLUMN by ROW.  The rows below and the columns right of the pivot."
  (flet ((others (list one) (sort (remove one list) #'<)))
    (let ((below (others (aref (front-below front) column) row))
          (right (others (aref (front-right front) row) column))
          (values (front-values front)) (size (front-size front)))
      (declare (type (simple-array double-float (*)) values) (fixnum size))
      (dolist (i below)
        (let ((part (/ (number-at front i column) (number-at front row column))))
          (declare (double-float part))
          (dolist (j right)
            (when (minusp (place-at front i j)) (add-entry front i j))
            (decf (aref values (+ j (* i size))) (* part (the double-float (number-at front row j)))))))
      (dolist (i below) (setf (aref (front-right front) i) (delete column (aref (front-right front) i))))
      (dolist (j right) (setf (aref (front-below front) j) (delete row (aref (front-below front) j))))
      (setf (aref (front-right front) row) '()
            (aref (front-below front) column) '())
      (values below right))))

(defparameter *longest-elimination* 1000000 "Beyond so many operations a loop over the whole matrix is as good.")

(defun pivoting-elimination (size rows columns)
  "Of a matrix with entries at ROWS and COLUMNS, with pivots chosen every time."
  (make-elimination :size size :rows (places rows) :columns (places columns)))

(defun planned-elimination (size rows columns values symmetric)
  "How to eliminate in a matrix with entries at ROWS and COLUMNS, those of its upper half if it is SYMMETRIC; VALUES are
their numbers at a sample.  Nil if no order of pivots can be had, or if it would be long."
  (let* ((front (first-front size rows columns values symmetric))
         (sizes (coerce (loop for i below size
                              collect (if symmetric
                                          (abs (number-at front i i))
                                          (largest-in front (aref (front-right front) i) i nil)))
                        'vector))
         (of-row (make-array size :initial-element '()))
         (measure '()) (factor '()) (forward '()) (backward '()) (length 0))
    (loop for i in rows
          for j in columns
          for place from 0
          do (when (or (not symmetric) (= i j)) (push place (aref of-row i))))
    (dotimes (k size)
      (destructuring-bind (&optional row . column)
          (if symmetric (diagonal-pivot front sizes) (any-pivot front sizes))
        (unless row (return-from planned-elimination nil))
        (multiple-value-bind (below right) (take-out-pivot front row column)
          (incf length (* (length below) (length right)))
          (when (> length *longest-elimination*) (return-from planned-elimination nil))
          (flet ((listed (head items) (list* head (length items) (loop for item in items append item))))
            (push (cons (length (aref of-row row)) (aref of-row row)) measure)
            (push (listed (place-at front row column)
                          (loop for i in below
                                for others = right then (if symmetric (rest others) right)
                                collect (listed (place-at front i column)
                                                (loop for j in others
                                                      collect (list (place-at front i j) (place-at front row j))))))
                  factor)
            (push (listed row (loop for i in below collect (list (place-at front i column) i))) forward)
            (push (listed column (loop for j in right collect (list (place-at front row j) j))) backward)))))
    (flet ((joined (lists) (places (loop for list in lists append list))))
      (make-elimination :size size :rows (places rows) :columns (places columns) :symmetric symmetric
                        :fill (- (front-count front) (length rows))
                        :measure (joined (nreverse measure)) :factor (joined (nreverse factor))
                        :forward (joined (nreverse forward)) :backward (joined backward)))))

;;; Solving

;; told beforehand, GCL passes the arguments unboxed
(declaim (ftype (function (fixnum t t t) t) measure-pivots)
         (ftype (function (fixnum t t) t) same-beginning)
         (ftype (function (fixnum t) t) clear-from)
         (ftype (function (fixnum t t t) fixnum) factor-in-place)
         (ftype (function (fixnum t t t t t t t) t) substitute-twice)
         (ftype (function (fixnum t t t t fixnum t t t) double-float) backward-error))

(defmacro with-next ((places) &body body)
  "BODY, in which (next) is the next of PLACES."
  (let ((position (gensym)))
    `(let ((,position 0))
       (declare (fixnum ,position))
       (macrolet ((next () '(let ((item (aref ,places ,position)))
                              (declare (fixnum item))
                              (setq ,position (the fixnum (1+ ,position)))
                              item)))
         ,@body))))

(defun measure-pivots (size measure entries sizes)
  "SIZES: what each pivot is compared with, the largest entry of its row, or what stood in its place."
  (declare (fixnum size) (type (simple-array fixnum (*)) measure) (type (simple-array double-float (*)) entries sizes))
  (with-fast-arithmetic
    (with-next (measure)
      (for (k size)
        (let ((largest 0d0))
          (declare (double-float largest))
          (for (e (next)) (setq largest (flo (max largest (abs (aref entries (next)))))))
          (setf (aref sizes k) largest))))
    nil))

(defun factor-in-place (size factor work inverses)
  "Eliminate in WORK.  INVERSES has what each pivot is compared with, and then their inverses.  2 if all pivots are
positive, 1 if not, 0 if one is negligible or not a number."
  (declare (fixnum size) (type (simple-array fixnum (*)) factor) (type (simple-array double-float (*)) work inverses))
  (with-fast-arithmetic
    (let ((negligible (flo (* 1d-15 (+ 0d0 size)))) (result 2))
      (declare (double-float negligible) (fixnum result))
      (with-next (factor)
        (for (k size)
          (let ((pivot (aref work (next))) (inverse 0d0))
            (declare (double-float pivot inverse))
            (unless (and (> (flo (abs pivot)) (flo (* negligible (aref inverses k)))) (< (flo (abs pivot)) 1d300))
              (return-from factor-in-place 0))
            (when (< pivot 0d0) (setq result 1))
            (setq inverse (flo (/ 1d0 pivot)))
            (setf (aref inverses k) inverse)
            (for (e (next))
              (let ((part (flo (* inverse (aref work (next))))))
                (declare (double-float part))
                (for (g (next))
                  (let ((place (next)))
                    (declare (fixnum place))
                    (setf (aref work place) (flo (- (aref work place) (* part (aref work (next)))))))))))))
      result)))

(defun substitute-twice (size forward backward work inverses right half solution)
  "SOLUTION of the equations with the right sides RIGHT, which are changed; HALF is what stands between."
  (declare (fixnum size) (type (simple-array fixnum (*)) forward backward)
           (type (simple-array double-float (*)) work inverses right half solution))
  (with-fast-arithmetic
    (with-next (forward)
      (for (k size)
        (let ((value (flo (* (aref inverses k) (aref right (next))))))
          (declare (double-float value))
          (setf (aref half k) value)
          (for (e (next))
            (let ((entry (aref work (next))) (row (next)))
              (declare (double-float entry) (fixnum row))
              (setf (aref right row) (flo (- (aref right row) (* entry value)))))))))
    (with-next (backward)
      (do ((k (fix (- size 1)) (fix (- k 1))))
          ((< k 0))
        (declare (fixnum k))
        (let ((column (next)) (value 0d0))
          (declare (fixnum column) (double-float value))
          (for (e (next))
            (let ((entry (aref work (next))))
              (declare (double-float entry))
              (setq value (flo (+ value (* entry (aref solution (next))))))))
          (setf (aref solution column) (flo (- (aref half k) (* (aref inverses k) value)))))))
    nil))

(defun backward-error (size rows columns entries symmetric offset solution residuals sizes)
  "The part of the entries by which they must be changed for SOLUTION to be exact.  The right sides stand in ENTRIES
from OFFSET on; SYMMETRIC is 1 for entries of an upper half, and 0 otherwise."
  (declare (fixnum size symmetric offset) (type (simple-array fixnum (*)) rows columns)
           (type (simple-array double-float (*)) entries solution residuals sizes))
  (with-fast-arithmetic
    (let ((worst 0d0))
      (declare (double-float worst))
      (for (i size)
        (let ((right (aref entries (fix (+ offset i)))))
          (declare (double-float right))
          (setf (aref residuals i) right
                (aref sizes i) (flo (abs right)))))
      (for (k (length rows))
        (let ((entry (aref entries k)) (i (aref rows k)) (j (aref columns k)))
          (declare (double-float entry) (fixnum i j))
          (macrolet ((take-off (i j)
                       `(let ((term (flo (* entry (aref solution ,j)))))
                          (declare (double-float term))
                          (setf (aref residuals ,i) (flo (- (aref residuals ,i) term))
                                (aref sizes ,i) (flo (+ (aref sizes ,i) (abs term)))))))
            (take-off i j)
            (unless (or (= symmetric 0) (= i j)) (take-off j i)))))
      (for (i size)
        (unless (= 0d0 (aref residuals i))
          (let ((part (flo (/ (abs (aref residuals i)) (aref sizes i)))))
            (declare (double-float part))
            (unless (<= part worst) (setq worst (if (<= part 1d300) part 1d300))))))
      worst)))

;;; (FILL and MISMATCH are slow on GCL.)
(defun clear-from (start array)
  (declare (fixnum start) (type (simple-array double-float (*)) array))
  (with-fast-arithmetic (for (k (length array) start) (setf (aref array k) 0d0)) nil))

(defun same-beginning (count first second)
  (declare (fixnum count) (type (simple-array double-float (*)) first second))
  (with-fast-arithmetic
    (for (k count) (unless (= (aref first k) (aref second k)) (return-from same-beginning nil)))
    t))

(defun pivoting-solver (elimination)
  "A function (entries solution), nil if the matrix is singular to working precision: the whole matrix, with a choice of
pivots."
  (let* ((size (elimination-size elimination))
         (rows (elimination-rows elimination)) (columns (elimination-columns elimination))
         (count (length rows)) (matrix nil) (scales nil))
    (flet ((doubles-for (number) (make-array number :element-type 'double-float)))
      (lambda (entries solution)
        (declare (type (simple-array double-float (*)) entries solution))
        (unless matrix (setq matrix (doubles-for (* size size)) scales (doubles-for size)))
        (fill matrix 0d0)
        (dotimes (k count)
          (let ((i (aref rows k)) (j (aref columns k)))
            (setf (aref matrix (+ j (* i size))) (aref entries k))
            (when (elimination-symmetric elimination) (setf (aref matrix (+ i (* j size))) (aref entries k)))))
        (replace solution entries :start2 count)
        (and (solve-scaled size matrix solution 0 scales) solution)))))

(defun make-linear-solver (elimination constant)
  "A function of an array, the entries of the matrix and then the right sides: an array with the solution, which the
next call changes, or nil if the matrix is singular to working precision.  With CONSTANT the factors are kept until the
matrix changes."
  (if (elimination-factor elimination)
      (planned-solver elimination constant)
      (let ((solver (pivoting-solver elimination))
            (solution (make-array (elimination-size elimination) :element-type 'double-float)))
        (lambda (entries) (funcall (the function solver) entries solution)))))

(defun planned-solver (elimination constant)
  (let* ((size (elimination-size elimination)) (count (length (elimination-rows elimination)))
         (rows (elimination-rows elimination)) (columns (elimination-columns elimination))
         (measure (elimination-measure elimination)) (factor (elimination-factor elimination))
         (forward (elimination-forward elimination)) (backward (elimination-backward elimination))
         (symmetric (if (elimination-symmetric elimination) 1 0))
         (enough (* 1d-15 (+ 4 (widest-row elimination))))
         (pivoting (pivoting-solver elimination))
         (state (make-array 1 :element-type 'fixnum :initial-element 0)))
    (flet ((doubles-for (number) (make-array number :element-type 'double-float :initial-element 0d0)))
      (let ((work (doubles-for (+ count (elimination-fill elimination)))) (inverses (doubles-for size))
            (kept (doubles-for count)) (right (doubles-for size)) (half (doubles-for size))
            (solution (doubles-for size)) (change (doubles-for size)) (sizes (doubles-for size)))
        (labels ((factored (entries)
                   "As FACTOR-IN-PLACE."
                   (cond ((and constant (plusp (aref state 0)) (same-beginning count kept entries)) (aref state 0))
                         (t (copy-part count entries 0 work)
                            (clear-from count work)
                            (measure-pivots size measure entries inverses)
                            (when constant (copy-part count entries 0 kept))
                            (setf (aref state 0) (factor-in-place size factor work inverses)))))
                 (off (entries)
                   (backward-error size rows columns entries symmetric count solution right sizes))
                 (corrected-p (entries)
                   "Whether SOLUTION is as good as any, after two corrections at most."
                   (or (<= (off entries) enough)
                       (loop repeat 2
                             do (substitute-twice size forward backward work inverses right half change)
                                (map-into solution #'+ solution change)
                                (when (<= (off entries) enough) (return t))))))
          (lambda (entries)
            (declare (type (simple-array double-float (*)) entries))
            (let ((pivots (factored entries)))
              (declare (fixnum pivots))
              (or (and (plusp pivots)
                       (progn (copy-part size entries count right)
                              (substitute-twice size forward backward work inverses right half solution)
                              t)
                       (or (and (= pivots 2) (= symmetric 1)) (corrected-p entries))
                       solution)
                  (funcall (the function pivoting) entries solution)))))))))

(defun widest-row (elimination)
  (let ((widths (make-array (elimination-size elimination) :initial-element 0)))
    (flet ((note (places) (map nil (lambda (i) (incf (aref widths i))) places)))
      (note (elimination-rows elimination))
      (when (elimination-symmetric elimination) (note (elimination-columns elimination))))
    (reduce #'max widths)))
