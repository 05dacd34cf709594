;;; anmech: equations A u = b arranged for being solved for u again and again, entries compiled.
;;;
;;; An unknown that stands alone in its equation, and nowhere else, is divided out: with a diagonal matrix nothing is
;;; left to be solved.  Of the others only the entries that are not zero are computed, of a symmetric matrix only the
;;; upper half, and the order of the pivots is chosen here (elimination.lisp).  But of very few equations all entries
;;; are computed, and linear.lisp solves them, which is as fast then.  Whether a matrix is symmetric, or constant along
;;; a motion, is read off the program.
;;;
;;; Entry points: the structure ARRANGEMENT; ARRANGED-EQUATIONS, CHESSBOARD-SIGN, UNKNOWNS-FUNCTION,
;;; UNKNOWNS-FUNCTION-IN-ONE, SOLVING-WORK.

(in-package :anmech)
(needs "arithmetic/elimination" "arithmetic/floats" "arithmetic/linear" "numerics/codegen" "numerics/evaluation"
       "numerics/sharing")

(defstruct arrangement
  equations          ; entries of the matrix, right sides, quotients
  system             ; function (in out) that computes them
  program            ; what that was made of
  signs              ; of each entry of the matrix: to which side noise changes it
  elimination
  constant           ; whether the matrix is the same at all states and times
  sources)           ; for each unknown its place in the solution, or, where it is a quotient, -1 - its place among all

;;; What is solved, and what is divided out

(defstruct pattern
  "SIZE equations that are coupled; for each entry of their matrix the number of the row and of the column.  WHOLE:
these are all entries, also those that are zero."
  size rows columns sources whole)

(defparameter *few-equations* 4 "So few equations are solved by a loop over the whole matrix.")

(defun nonzero-p (entry) (not (and (numberp entry) (zerop entry))))

(defun nonzero-entries (matrix)
  "Lists (row column entry) of a MATRIX by rows."
  (loop for row in matrix
        for i from 0
        append (loop for entry in row
                     for j from 0
                     when (nonzero-p entry) collect (list i j entry))))

(defun entries-alone (entries size)
  "Those of ENTRIES that have no others in their row or column."
  (let ((in-row (make-array size :initial-element 0)) (in-column (make-array size :initial-element 0)))
    (loop for (i j) in entries do (incf (aref in-row i)) (incf (aref in-column j)))
    (remove-if-not (lambda (entry) (= 1 (aref in-row (first entry)) (aref in-column (second entry)))) entries)))

(defun split-equations (matrix right)
  "The pattern, and the expressions of which values are wanted: entries, right sides, quotients."
  (let* ((size (length right)) (right (coerce right 'vector)) (entries (nonzero-entries matrix))
         (alone (entries-alone entries size))
         (rows (others-below size (mapcar #'first alone))) (columns (others-below size (mapcar #'second alone)))
         (row-numbers (numbers-of rows size)) (column-numbers (numbers-of columns size))
         (whole (<= (length rows) *few-equations*))
         (coupled (if whole
                      (loop for i in rows append (loop for j in columns collect (list i j (nth j (nth i matrix)))))
                      (remove-if (lambda (entry) (minusp (aref row-numbers (first entry)))) entries))))
    (values (make-pattern :size (length rows) :whole whole
                          :rows (mapcar (lambda (entry) (aref row-numbers (first entry))) coupled)
                          :columns (mapcar (lambda (entry) (aref column-numbers (second entry))) coupled)
                          :sources (unknown-sources column-numbers (mapcar #'second alone)
                                                    (length coupled) (length rows) whole))
            (append (mapcar #'third coupled)
                    (mapcar (lambda (i) (aref right i)) rows)
                    (loop for (i nil entry) in alone collect (quotient-form (aref right i) entry))))))

(defun unknown-sources (column-numbers alone entries count whole)
  "Where each unknown is found; ALONE are the columns of quotients, which stand behind ENTRIES and COUNT right sides."
  (let ((sources (copy-seq column-numbers)))
    (when whole                     ; the solution takes the place of the right sides
      (map-into sources (lambda (number) (- -1 (+ entries number))) column-numbers))
    (loop for j in alone
          for place from (+ entries count)
          do (setf (aref sources j) (- -1 place)))
    sources))

(defun others-below (size list)
  "The integers below SIZE that are not in LIST."
  (let ((flags (make-array size :initial-element t)))
    (dolist (i list) (setf (aref flags i) nil))
    (loop for i below size when (aref flags i) collect i)))

(defun numbers-of (list size)
  "For each integer below SIZE its place in LIST, -1 if it has none."
  (let ((numbers (make-array size :element-type 'fixnum :initial-element -1)))
    (loop for i in list
          for k from 0
          do (setf (aref numbers i) k))
    numbers))

(defun quotient-form (above below)
  (if (eql below 1) above `((maxima::mtimes) ,above ((maxima::mexpt) ,below -1))))

;;; What the program tells

(defun constant-results-p (program count inputs)
  "Whether the first COUNT results of PROGRAM depend on none of the first INPUTS inputs."
  (let* ((instructions (program-instructions program))
         (depends (make-array (length instructions) :initial-element nil)))
    (flet ((depends-p (operand)
             (cond ((null operand) nil)
                   ((integerp operand) (aref depends operand))
                   (t (and (eq :input (car operand)) (< (cdr operand) inputs))))))
      (dotimes (k (length instructions))
        (setf (aref depends k) (some #'depends-p (rest (aref instructions k)))))
      (notany #'depends-p (subseq (program-results program) 0 count)))))

(defun symmetric-results-p (program pattern)
  "Whether entries of PATTERN that mirror each other are the same operands."
  (let ((operands (make-hash-table)) (size (pattern-size pattern)))
    (loop for i in (pattern-rows pattern)
          for j in (pattern-columns pattern)
          for operand in (program-results program)
          do (setf (gethash (+ j (* i size)) operands) operand))
    (loop for i in (pattern-rows pattern)
          for j in (pattern-columns pattern)
          for operand in (program-results program)
          always (multiple-value-bind (mirrored present) (gethash (+ i (* j size)) operands)
                   (and present (equal operand mirrored))))))

(defparameter *sample-ranges* '((0.5d0 1.5d0) (0.1d0 0.9d0) (1.1d0 3d0) (-0.9d0 0.9d0))
  "Where numbers for a sample are tried.")

(defun sample-values (program count inputs)
  "The first COUNT results of PROGRAM for some numbers as inputs, the same at every call; nil if they have no values."
  (let ((seed 1))
    (flet ((number (low high)
             (setq seed (mod (* 16807 seed) 2147483647))
             (+ low (* (- high low) (/ seed 2147483647d0))))
           (finite-p (value) (< (abs value) 1d100)))
      (loop for (low high) in *sample-ranges*
            for in = (coerce (loop repeat inputs collect (number low high)) 'double-array)
            for values = (handler-case (subseq (funcall (program-function program) in) 0 count)
                           ((or domain-violation arithmetic-error) () nil))
            when (and values (every #'finite-p values)) return values))))

(defun values-for-pattern (rows columns)
  "Numbers for entries of which nothing else is known: each as good as another, those of the diagonal better."
  (loop for i in rows
        for j in columns
        for k from 1
        collect (if (= i j) 2d0 (+ 0.5d0 (/ (mod (* 7919 k) 1009) 2018d0)))))

(defun best-elimination (program pattern inputs)
  "The elimination, and whether it takes the upper half only."
  (let* ((size (pattern-size pattern)) (rows (pattern-rows pattern)) (columns (pattern-columns pattern))
         (values (or (sample-values program (length rows) inputs) (values-for-pattern rows columns)))
         (upper (mapcar #'<= rows columns)))
    (or (and (symmetric-results-p program pattern)
             (planned-elimination size (chosen rows upper) (chosen columns upper) (chosen values upper) t))
        (planned-elimination size rows columns values nil)
        (pivoting-elimination size rows columns))))

(defun chosen (list flags)
  "Those of LIST whose flag is set, and those that have none."
  (loop for item in list
        for rest = flags then (rest rest)
        when (or (null rest) (first rest)) collect item))

;;; The arrangement

(defun arranged-equations (matrix right inputs states)
  "The arrangement of MATRIX u = RIGHT, expressions in INPUTS, the first STATES of which change along a motion; and
nothing else if all unknowns are quotients: the list of these."
  (multiple-value-bind (pattern expressions) (split-equations matrix right)
    (if (zerop (pattern-size pattern))
        (values nil (loop for source across (pattern-sources pattern) collect (nth (- -1 source) expressions)))
        (compiled-arrangement pattern expressions inputs states))))

(defun chessboard-sign (row column)
  "To which side an entry is changed by noise, 1 or -1: in a nearly singular matrix products of entries cancel, of which
the one then grows and the other falls.  Signs by chance may leave them alike."
  (if (evenp (+ row column)) 1 -1))

(defun compiled-arrangement (pattern expressions inputs states)
  (let* ((rows (pattern-rows pattern)) (columns (pattern-columns pattern))
         (signs (mapcar #'chessboard-sign rows columns)))
    (multiple-value-bind (system program elimination constant)
        (compiled-before expressions inputs (list rows columns states)
                         (lambda (expressions) (compiled-entries expressions inputs states pattern)))
      (make-arrangement :equations (if (elimination-symmetric elimination)
                                       (chosen expressions (mapcar #'<= rows columns))
                                       expressions)
                        :signs (if (elimination-symmetric elimination)
                                   (loop for sign in signs for i in rows for j in columns when (<= i j) collect sign)
                                   signs)
                        :system system :program program :elimination elimination :constant constant
                        :sources (if (elimination-symmetric elimination)
                                     (map 'vector (lambda (source)
                                                    (if (minusp source)        ; the lower half is gone before it
                                                        (+ source (count t (mapcar #'> rows columns)))
                                                        source))
                                          (pattern-sources pattern))
                                     (pattern-sources pattern))))))

(defun compiled-entries (expressions inputs states pattern)
  "A function (in out), its program, the elimination, and whether the matrix is constant."
  (let* ((program (expressions-program expressions inputs))
         (count (length (pattern-rows pattern)))
         (elimination (if (pattern-whole pattern)
                          (make-elimination :size (pattern-size pattern))
                          (best-elimination program pattern (length inputs))))
         (constant (constant-results-p program count states)))
    (when (elimination-symmetric elimination)
      (setf (program-results program)
            (chosen (program-results program) (mapcar #'<= (pattern-rows pattern) (pattern-columns pattern)))))
    (values (compiled-program program) program elimination constant)))

;;; The unknowns as a function

(declaim (ftype (function (t t t t t t) t) hand-out)
         (ftype (function (t t t t t t t) t) solve-whole solve-planned))

#+sbcl (declaim (inline hand-out))

(defun hand-out (in out places solution entries sources)
  "OUT: the states in IN at PLACES, then the unknowns of SOURCES."
  (declare (type (simple-array fixnum (*)) places sources)
           (type (simple-array double-float (*)) in out solution entries))
  (with-fast-arithmetic
    (let ((offset (length places)))
      (declare (fixnum offset))
      (for (k offset) (setf (aref out k) (aref in (aref places k))))
      (for (k (length sources))
        (let ((source (aref sources k)))
          (declare (fixnum source))
          (setf (aref out (fix (+ offset k)))
                (if (< source 0) (aref entries (fix (- -1 source))) (aref solution source)))))
      nil)))

(defun tell-singular () (error 'domain-violation :operation :solve :source nil))

(defun solve-whole (system in out places entries sources scales)
  "For equations of which all entries are there, and quotients."
  (declare (type function system) (type (simple-array double-float (*)) in out entries scales))
  (with-fast-arithmetic
    (funcall system in entries)
    (let ((size (length scales)))
      (declare (fixnum size))
      (unless (solve-scaled size entries entries (fix (* size size)) scales) (tell-singular)))
    (hand-out in out places entries entries sources)))

(defun solve-planned (system in out places entries sources solver)
  (declare (type function system solver))
  (with-fast-arithmetic
    (funcall system in entries)
    (hand-out in out places
              (or (funcall solver entries) (tell-singular))
              entries sources)))

(defun solving-work (arrangement)
  "About how many operations it takes to solve the equations."
  (let* ((elimination (arrangement-elimination arrangement)) (size (elimination-size elimination)))
    (if (elimination-factor elimination)
        (length (elimination-factor elimination))
        (floor (* 2 size size size) 3))))

(defun unknowns-function (arrangement system velocities n)
  "A function (in out): the states in IN at VELOCITIES, then the first N unknowns of the equations that SYSTEM
computes."
  (let* ((elimination (arrangement-elimination arrangement))
         (places (places velocities))
         (sources (places (coerce (subseq (arrangement-sources arrangement) 0 n) 'list))))
    (flet ((doubles-for (number) (make-array number :element-type 'double-float)))
      (let ((entries (doubles-for (length (arrangement-equations arrangement)))))
        (if (elimination-rows elimination)
            (let ((solver (make-linear-solver elimination (arrangement-constant arrangement))))
              (lambda (in out) (solve-planned system in out places entries sources solver)))
            (let ((scales (doubles-for (elimination-size elimination))))
              (lambda (in out) (solve-whole system in out places entries sources scales))))))))

(defun unknowns-function-in-one (arrangement velocities n)
  "The same function compiled together with the system, entries and solution in variables: it takes half of the time
where equations are few, and as long to compile as a million of its calls save.  Nil where it would be too long."
  (let* ((elimination (arrangement-elimination arrangement)) (size (elimination-size elimination))
         (program (arrangement-program arrangement)))
    (flet ((finish (results)
             (let* ((names (loop repeat (length results) collect (gensym))) (rights (nthcdr (* size size) names)))
               `((let ,(mapcar #'list names results)
                   (declare (double-float ,@names))
                   ,(form-of-solution size names rights '(tell-singular))
                   ,@(loop for place in velocities
                           for k from 0
                           collect `(setf (aref out ,k) (aref in ,place)))
                   ,@(loop for source across (subseq (arrangement-sources arrangement) 0 n)
                           for k from (length velocities)
                           collect `(setf (aref out ,k) ,(nth (- -1 source) names))))))))
      (and (null (elimination-rows elimination))
           (one-block-p program)
           (compiled-program program #'finish)))))
