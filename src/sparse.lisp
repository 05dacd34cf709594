;;; anmech: sparse linear equations, exactly over a field of rational functions of parameters.
;;;
;;; A row is an alist from columns to field elements, sorted by columns, without zeros.  Elements are Lisp rationals wherever
;;; they can be, else expressions of Maxima.  Pivots are taken from short rows, and numbers before expressions, so that
;;; parameters are divided by as late as possible; what has to be divided by tells for which of their values
;;; the result does not hold.  (Maxima's linsolve is not used: with parameters in denominators it has given wrong answers.)
;;;
;;; Entry points: null-vectors, elimination-pivots; as-form, as-rational.
;;;
;;; Literature: I. S. Duff, A. M. Erisman, J. K. Reid, Direct Methods for Sparse Matrices (1986), chapter 7.

(in-package :anmech)

;;; Field elements: Lisp rationals, or expressions of Maxima

(defun as-rational (form)
  (if (operator-p form 'maxima::rat) (/ (second form) (third form)) form))

(defun as-form (element)
  (if (typep element 'ratio)
      (list '(maxima::rat maxima::simp) (numerator element) (denominator element))
      element))

(defun in-field (rational general &rest elements)
  "RATIONAL of the elements if they are numbers, else GENERAL of them, simplified."
  (if (every #'rationalp elements)
      (apply rational elements)
      (as-rational (maxima::$ratsimp (apply general (mapcar #'as-form elements))))))

(defun minus-product (a factor b)
  (in-field (lambda (a f b) (- a (* f b))) (lambda (a f b) (maxima::sub a (maxima::mul f b))) a factor b))

(defun quotient-of (a b)
  (in-field #'/ #'maxima::div a b))

;;; Rows

(defun subtract-row (row factor other)
  "ROW - FACTOR * OTHER."
  (let ((result '()))
    (loop while (or row other)
          do (cond ((or (null other) (and row (< (caar row) (caar other)))) (push (pop row) result))
                   (t (let ((value (if (and row (= (caar row) (caar other)))
                                       (minus-product (cdr (pop row)) factor (cdar other))
                                       (minus-product 0 factor (cdar other)))))
                        (unless (eql value 0) (push (cons (caar other) value) result))
                        (pop other)))))
    (nreverse result)))

(defun pivot-cost (row)
  "Short rows first, and among them those with a number to divide by."
  (+ (* 4 (length row)) (if (some (lambda (pair) (rationalp (cdr pair))) row) 0 2)))

(defun pivot-of (row)
  (or (find-if (lambda (pair) (rationalp (cdr pair))) row) (first row)))

(defun reduced-rows (rows)
  "A list of (column . row): the unknown of that column is minus the rest of the row, in which no other such column occurs."
  (let ((done '()))
    (loop while rows
          do (let* ((row (reduce (lambda (a b) (if (<= (pivot-cost a) (pivot-cost b)) a b)) rows))
                    (pivot (pivot-of row))
                    (unit (mapcar (lambda (pair) (cons (car pair) (quotient-of (cdr pair) (cdr pivot)))) row)))
               (flet ((clear (other)
                        (let ((place (assoc (car pivot) other)))
                          (if place (subtract-row other (cdr place) unit) other))))
                 (setq rows (remove nil (mapcar #'clear (remove row rows :test #'eq :count 1)))
                       done (acons (car pivot) unit
                                   (mapcar (lambda (pair) (cons (car pair) (clear (cdr pair)))) done))))))
    done))

(defun without-denominators (vector)
  "A multiple of VECTOR without denominators."
  (let ((multiple 1))
    (dolist (form vector)
      (let ((denominator (maxima::$denom form)))
        (setq multiple (maxima::$ratsimp (maxima::div (maxima::mul multiple denominator)
                                                      (maxima::$gcd multiple denominator))))))
    (mapcar (lambda (form) (maxima::$ratsimp (maxima::mul multiple form))) vector)))

(defun null-vectors (rows count)
  "A basis of the vectors of COUNT entries that ROWS annihilate."
  (let ((solved (reduced-rows rows)))
    (loop for free below count
          unless (assoc free solved)
            collect (without-denominators
                     (loop for j below count
                           for row = (cdr (assoc j solved))
                           collect (cond ((= j free) 1)
                                         ((assoc free row) (as-form (in-field #'- #'maxima::neg (cdr (assoc free row)))))
                                         (t 0)))))))

(defun elimination-pivots (rows)
  "The pivots, without numbers, of an elimination of exact ROWS that divides by parameters as late as it can."
  (let ((pivots '()))
    (loop while rows
          do (let* ((row (reduce (lambda (a b) (if (<= (pivot-cost a) (pivot-cost b)) a b)) rows))
                    (pivot (pivot-of row)))
               (unless (rationalp (cdr pivot)) (push (cdr pivot) pivots))
               (setq rows (loop for other in (remove row rows :test #'eq :count 1)
                                for place = (assoc (car pivot) other)
                                for rest = (if place
                                               (subtract-row other (quotient-of (cdr place) (cdr pivot)) row)
                                               other)
                                when rest collect rest))))
    (nreverse pivots)))
